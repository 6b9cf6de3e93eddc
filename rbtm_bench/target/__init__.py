"""What a scan is registered to."""

from rbtm_bench.target.around_model import AroundModel
from rbtm_bench.target.base import Target
from rbtm_bench.target.keyframes import LastKeyframes
from rbtm_bench.target.local_map import LocalMap
from rbtm_bench.target.running_map import RunningVoxelMap
from rbtm_bench.target.single import SingleScan

__all__ = ["AroundModel", "LastKeyframes", "LocalMap", "RunningVoxelMap", "SingleScan", "Target"]
