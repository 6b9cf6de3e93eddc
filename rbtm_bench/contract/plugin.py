"""The options of the contract tests, and one core for the process that runs them.

``conftest.py`` loads this by itself where pytest sees it in time (a checkout); for an installed
package say ``-p rbtm_bench.contract.plugin``, or use ``python -m rbtm_bench.contract``.
"""

from __future__ import annotations

import pytest

from rbtm_bench.contract.members import CATALOGUE, Catalogue
from rbtm_bench.core.errors import ConfigError
from rbtm_bench.runs.pinning import pin_to_free_core


def pytest_addoption(parser: pytest.Parser) -> None:
    """Which plug-ins are put to the test, and with which settings."""
    group = parser.getgroup("rbtm_bench", "contract tests of rbtm_bench plug-ins")
    group.addoption(
        "--config-dir",
        action="append",
        default=[],
        metavar="DIR",
        help="a folder of configs with more plug-ins (DIR/backend/mine.yaml); may be repeated",
    )
    group.addoption(
        "--plugin",
        action="append",
        default=[],
        metavar="GROUP=NAME",
        help="test this plug-in only, e.g. backend=mine; may be repeated",
    )
    group.addoption(
        "--override",
        action="append",
        default=[],
        metavar="KEY=VALUE",
        help="a setting for the plug-ins of KEY's group, e.g. dataset.path=LOG; may be repeated",
    )


def pytest_configure(config: pytest.Config) -> None:
    """Pin before any backend library is imported, and look up the plug-ins that are asked for."""
    if not hands_out_work(config):
        pin_to_free_core()
    folder_of_call = config.invocation_params.dir
    try:
        catalogue = Catalogue.of_options(
            [folder_of_call / str(folder) for folder in config.getoption("config_dir", default=[])],
            config.getoption("plugin", default=[]),
            config.getoption("override", default=[]),
        )
        catalogue.check_libraries()
    except ConfigError as error:
        raise pytest.UsageError(str(error)) from error
    config.stash[CATALOGUE] = catalogue


def hands_out_work(config: pytest.Config) -> bool:
    """True for the process that only starts pytest-xdist's workers: they inherit its cores."""
    return not hasattr(config, "workerinput") and bool(config.getoption("tx", default=[]))
