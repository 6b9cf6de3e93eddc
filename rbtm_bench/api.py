"""The public face: what ``import rbtm_bench as rb`` gives, over the parts that the commands use.

Settings are keyword arguments, two underscores for the command line's dot (``runs.keywords``).
"""

from __future__ import annotations

import itertools
import os
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any
from weakref import WeakKeyDictionary

import numpy as np

from rbtm_bench.backends.base import Backend
from rbtm_bench.backends.system import System
from rbtm_bench.core.errors import ConfigError, DataError, RunError
from rbtm_bench.core.trajectory import Trajectory
from rbtm_bench.core.types import RegistrationResult
from rbtm_bench.datasets import summary
from rbtm_bench.datasets.base import Dataset
from rbtm_bench.datasets.in_memory import FirstScan, numbered, scan_of
from rbtm_bench.engine import drive, driver
from rbtm_bench.engine.comparison import Comparison
from rbtm_bench.engine.sweep_folder import Asked
from rbtm_bench.odometry import judge, loop
from rbtm_bench.odometry.result import Odometry
from rbtm_bench.odometry.system import system_odometry
from rbtm_bench.report import frame, screen
from rbtm_bench.runs import assembly, evaluation, keywords, replicate, stored
from rbtm_bench.runs.claim import default_folder
from rbtm_bench.runs.experiment import BLOCK
from rbtm_bench.runs.plugins import is_system
from rbtm_bench.runs.settings import Settings, compose_settings
from rbtm_bench.runs.words import as_typed, data_words
from rbtm_bench.selection.base import Selector

if TYPE_CHECKING:
    import pandas as pd

Folders = str | os.PathLike[str] | Sequence[str | os.PathLike[str]]

_opened: WeakKeyDictionary[Dataset, list[str]] = WeakKeyDictionary()
"""The words that data sets were opened by: they bring settings for what works on them."""


def register(
    source: Any,
    target: Any,
    backend: str | Backend = "open3d_gicp",
    guess: Any = None,
    *,
    config_dir: Folders = (),
    **settings: Any,
) -> RegistrationResult:
    """Register one scan to another.

    Parameters
    ----------
    source, target : array (N, 2) or (N, 3) in m, Open3D point cloud, or Scan
        Two columns, or a third of zeros alone, are planar scans.
    backend : str or Backend
        A member of the group ``backend`` (``rbtm-bench list backend``), or one of your own.
    guess : array (4, 4), optional
        The initial ``T_target_source``; without one: no motion.
    config_dir : path or list of paths
        Folders with plug-ins of your own, as ``--config-dir``.
    **settings
        Of the backend, its search, ``registration`` and ``judge_points``:
        ``backend__max_correspondence_distance=0.5``, ``search="correlative"``.

    Returns
    -------
    RegistrationResult
        ``T_target_source`` (4, 4), ``converged``, and judged alike for all backends ``fitness``,
        ``inlier_rmse`` (m), ``inliers`` and ``localizability``.

    Raises
    ------
    ConfigError
        For a wrong setting, or a backend that is not for such scans.
    BackendError
        If the scans cannot be registered: too few points, or the library raises.

    Source
    ------
    Fitness and inlier RMSE as Open3D's ``evaluate_registration``.
    """
    scans = [scan_of(source, 0), scan_of(target, 1)]
    if scans[0].planar is not scans[1].planar:
        raise DataError("source and target: one is planar and the other is not")
    given, named = keywords.objects_and_names(
        {"backend": backend, **settings}, keywords.OF_PAIR, "register"
    )
    composed = _composed([*keywords.defaults_for(scans[0]), *keywords.of_values(named)], config_dir)
    config = composed.config
    if isinstance(given.get("backend"), System) or ("backend" not in given and is_system(config)):
        raise ConfigError(f"backend={backend} is a whole odometry: expected one that takes pairs")
    assembly.check_dimensions(composed, scans[0].planar, given.get("backend"))
    method = assembly.build_backend(config, given.get("backend"))
    prepared = [method.prepare(scan) for scan in scans]
    T_guess = np.eye(4) if guess is None else guess
    judged_by = config["judge_points"], config["judge_radius"]
    return judge.register(method, prepared[0], prepared[1], T_guess, *judged_by)


def odometry(
    scans: Iterable[Any],
    backend: str | Backend | System = "open3d_gicp",
    selector: str | Selector = "rbtm",
    *,
    config_dir: Folders = (),
    **settings: Any,
) -> Odometry:
    """Register every scan to a past one that the selector chooses, in this process.

    Parameters
    ----------
    scans : iterable of arrays (N, 2) or (N, 3) in m, Open3D point clouds, or Scans
        A list, a data set (``open_dataset``) or a live stream, which is read one scan at a time.
        Arrays are numbered, and their number is their stamp in s; a ``Scan`` brings its stamp,
        beams and odometry.
    backend : str, Backend or System
        A member of the group ``backend``, or one of your own.
    selector : str or Selector
        A member of the group ``selector``, or one of your own; so for ``similarity``, ``guess``,
        ``check`` and ``target``.
    config_dir : path or list of paths
        Folders with plug-ins of your own, as ``--config-dir``.
    **settings
        Of these groups: ``selector__window=20``, ``guess="identity"``. A data set brings the
        defaults of its config. Without one they are those of ``corridor`` for planar scans and of
        ``cloud_folder`` for others, with the odometry as the guess if scans have it, and
        ``similarity="overlap"`` for planar scans without beams.

    Returns
    -------
    Odometry
        With ``trajectory``, ``steps`` and ``edges``; an iterator over the steps.

    Raises
    ------
    ConfigError
        For a wrong setting, or parts that do not fit the first scan.
    DataError
        For no scans, or what is no scan.
    """
    is_stream = isinstance(scans, Iterator)
    stream = numbered(scans)
    first = next(stream, None)
    if first is None:
        raise DataError("no scans: expected at least one")
    asked = {"backend": backend, "selector": selector, **settings}
    given, named = keywords.objects_and_names(asked, keywords.OF_METHOD, "odometry")
    words = keywords.defaults_for(first)
    if isinstance(scans, Dataset):
        words = _opened.get(scans, words)
    composed = _composed([*words, *keywords.of_values(named)], config_dir)
    config, dataset = composed.config, scans if isinstance(scans, Dataset) else FirstScan(first)
    assembly.check_dimensions(composed, first.planar, given.get("backend"))
    assembly.check_fit(composed, dataset)
    every = itertools.chain([first], stream)
    node = assembly.build(config["backend"]) if is_system(config) else None
    if isinstance(system := given.get("backend", node), System):
        return Odometry(system_odometry(every, system))
    method = assembly.method_on(dataset, config, given)
    block = 1 if is_stream or given else BLOCK
    return Odometry(loop.odometry(every, method, block=block))


def open_dataset(
    path: str | os.PathLike[str] | None = None, *, config_dir: Folders = (), **settings: Any
) -> Dataset:
    """Open data: recognised from a path, or chosen by name.

    Parameters
    ----------
    path : path, optional
        A CARMEN log, a folder of clouds, KITTI's layout, or a bag.
    config_dir : path or list of paths
        Folders with plug-ins of your own, as ``--config-dir``.
    **settings
        Of the data set and of what is done to it: ``dataset="corridor"``, ``dataset__scans=50``,
        ``seed=1``, ``perturb__dropout=0.1``.

    Returns
    -------
    Dataset
        ``len``, ``dataset[i]`` and iteration give Scans. What was guessed about it is printed on
        standard error, and in ``readings`` and ``suspicions``.

    Raises
    ------
    DataError
        For a path that is not recognised, or bad data.
    ConfigError
        For a wrong setting.
    """
    given, named = keywords.objects_and_names(settings, keywords.OF_DATA, "open_dataset")
    if given:
        raise ConfigError("dataset: expected a name; what is a Dataset already is open")
    words = _with_path(path, keywords.of_values(named))
    config = _composed(words, config_dir).config
    dataset = replicate.copy_of(assembly.build(config["dataset"]), config)
    summary.tell(dataset)
    _opened[dataset] = words
    return dataset


def run(
    path: str | os.PathLike[str] | None = None, *, config_dir: Folders = (), **settings: Any
) -> stored.Run:
    """One run in a process of its own, as ``rbtm-bench run`` makes it.

    Parameters
    ----------
    path : path, optional
        Data, recognised as by ``open_dataset``; else ``dataset`` chooses them.
    config_dir : path or list of paths
        Folders with plug-ins of your own, as ``--config-dir``.
    **settings
        All that a command takes: ``backend="plicp"``, ``selector__window=20``, ``out="results/a"``
        (default: a new folder in results/runs).

    Returns
    -------
    Run
        ``path``, ``metrics``, ``config`` (all settings) and ``record`` (run.json).

    Raises
    ------
    ConfigError, DataError
        Before anything is written, for a wrong setting or bad data.
    RunError
        If the run fails, with its reason.
    """
    words = _with_path(path, keywords.of_values(settings))
    composed = _composed(words, config_dir)
    out = Path(composed.config["out"] or default_folder("runs", composed.choices))
    drive.run_alone(composed, out, argv=["rbtm-bench", "run", *words, *_as_options(config_dir)])
    return stored.read_run(out)


def compare(
    path: str | os.PathLike[str] | None = None,
    *,
    jobs: int | None = None,
    config_dir: Folders = (),
    **settings: Any,
) -> pd.DataFrame:
    """A grid of runs, each in a process of its own, as ``rbtm-bench compare`` makes it.

    Parameters
    ----------
    path : path, optional
        Data, recognised as by ``open_dataset``; else ``dataset`` chooses them.
    jobs : int, optional
        Runs side by side; default: one a core.
    config_dir : path or list of paths
        Folders with plug-ins of your own, as ``--config-dir``.
    **settings
        As for ``run``; a list of values (a tuple, a range) multiplies: ``backend=["plicp",
        "open3d_p2p"], seed=range(5)``. A setting that is a list itself is a list in a list.
        ``controls="none"`` leaves out the controls that rbtm's runs bring along.

    Returns
    -------
    DataFrame
        A row a run, as ``load_runs`` gives it; one that failed says so in ``status`` and
        ``reason``. ``attrs["out"]`` is the folder (default: a new one in results/compare), with
        table.csv and summary.csv; ``compare --resume`` goes on with it.

    Raises
    ------
    ConfigError, DataError
        Before anything is written, for a wrong setting or bad data.
    """
    words = _with_path(path, keywords.of_values(settings, several=True))
    workers = drive.default_jobs() if jobs is None else jobs
    if workers < 1:
        raise ConfigError(f"jobs={jobs}: expected at least 1")
    folders = _folders(config_dir)
    grid = Comparison.of(words, folders, workers)
    out = Path(grid.settings[0].config["out"] or default_folder("compare"))
    typed = [*words, *_as_options(config_dir)]
    asked = Asked.now("compare", typed, words, map(str, folders), False)
    ended = driver.drive(grid, asked, out, resumed=False)
    runs = [folder for folder in ended.folders if (folder / "run.json").is_file()]
    if not runs:
        raise RunError(f"{out}: no run could be begun")
    screen.write_tables(out, screen.tables_of(runs))
    return load_runs(out)


def load_runs(path: Folders, over_seeds: bool = False) -> pd.DataFrame:
    """Finished runs as a table.

    Parameters
    ----------
    path : path or list of paths
        Run folders, or folders of them.
    over_seeds : bool
        A row a method, medians over its seeds and replicates, instead of a row a run.

    Returns
    -------
    DataFrame
        The columns of ``rbtm-bench table`` (docs/metrics.md); ``attrs["out"]`` is ``path``.

    Raises
    ------
    DataError
        For a path without any run.
    """
    runs = stored.find_runs(_folders(path))
    table = frame.over_seeds(runs) if over_seeds else frame.frame(runs)
    table.attrs["out"] = str(path) if isinstance(path, str | os.PathLike) else None
    return table


def evaluate(
    estimate: Any, reference: Any, *, tolerance_s: float = 0.02, **settings: Any
) -> dict[str, float | int | None]:
    """What an estimated trajectory is worth.

    Parameters
    ----------
    estimate : Odometry, Trajectory, array (N, 4, 4) of T_world_scan, or path of a TUM file
    reference : Dataset, or as ``estimate``
        A data set's ground truth and relations, pose by pose of its scans; of trajectories with
        other stamps the pose nearest in time; arrays pose by pose.
    tolerance_s : float
        s between poses that belong together.
    **settings
        Of the metrics: ``metrics__ape__align="umeyama"``.

    Returns
    -------
    dict
        The keys of metrics.json that need no more than poses (docs/metrics.md): a number, or None
        where it does not exist.

    Raises
    ------
    DataError
        If nothing belongs together, or the data set knows no truth.
    """
    _, named = keywords.objects_and_names(settings, ("metrics",), "evaluate")
    metrics = assembly.build_metrics(_composed(keywords.of_values(named), ()).config)
    poses = _trajectory(estimate, "estimate")
    if isinstance(reference, Dataset):
        truth, first = evaluation.truth_of(reference), reference.scored_from
        return evaluation.evaluate(metrics, poses, truth, reference, first)[0]
    true = _trajectory(reference, "reference")
    if not isinstance(estimate, np.ndarray) and not isinstance(reference, np.ndarray):
        poses, true = evaluation.by_time(poses, true, tolerance_s)
    values: dict[str, float | int | None] = {}
    for metric in metrics:
        values |= metric.evaluate(poses, true, None)
    return values


def _trajectory(given: Any, name: str) -> Trajectory:
    if isinstance(given, Odometry):
        return given.trajectory
    if isinstance(given, str | os.PathLike):
        return Trajectory.read_tum(given)
    if isinstance(given, Trajectory):
        return given
    if (poses := np.asarray(given, np.float64)).ndim != 3 or poses.shape[1:] != (4, 4):
        raise DataError(f"{name}: {poses.shape}: expected poses (N, 4, 4)")
    return Trajectory(np.arange(len(poses), dtype=np.float64), poses)


def _composed(words: list[str], config_dir: Folders) -> Settings:
    return compose_settings(words, _folders(config_dir))


def _folders(given: Folders) -> tuple[Path, ...]:
    return tuple(map(Path, [given] if isinstance(given, str | os.PathLike) else given))


def _as_options(config_dir: Folders) -> list[str]:
    return [word for folder in _folders(config_dir) for word in ("--config-dir", str(folder))]


def _with_path(path: str | os.PathLike[str] | None, words: list[str]) -> list[str]:
    if path is None:
        return words
    keys = [word.partition("=")[0] for word in words]
    return [*as_typed(data_words(os.fspath(path), keys)), *words]
