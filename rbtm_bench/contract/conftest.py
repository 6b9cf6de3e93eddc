"""Fixtures of the contract tests: ``member`` is every plug-in of the module's ``GROUP`` in turn."""

from __future__ import annotations

import pytest

from rbtm_bench.backends.base import Backend
from rbtm_bench.contract.members import CATALOGUE, Catalogue, Member
from rbtm_bench.contract.scene import WORLDS, World


def pytest_addoption(pluginmanager: pytest.PytestPluginManager) -> None:
    """Our options, wherever pytest has not loaded them yet."""
    pluginmanager.import_plugin("rbtm_bench.contract.plugin")


def pytest_generate_tests(metafunc: pytest.Metafunc) -> None:
    """A test that asks for ``member`` runs for every plug-in of its module's group."""
    if "member" in metafunc.fixturenames:
        systems = getattr(metafunc.module, "SYSTEMS", False)
        members = metafunc.config.stash[CATALOGUE].members(metafunc.module.GROUP, systems)
        metafunc.parametrize("member", members, ids=[m.name for m in members], scope="module")


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """With ``--plugin``, leave out the other plug-ins."""
    catalogue = config.stash[CATALOGUE]
    others = [item for item in items if not _is_wanted(item, catalogue)]
    if others:
        config.hook.pytest_deselected(items=others)
        items[:] = [item for item in items if _is_wanted(item, catalogue)]


def _is_wanted(item: pytest.Item, catalogue: Catalogue) -> bool:
    callspec = getattr(item, "callspec", None)
    member = callspec.params.get("member") if callspec else None
    return not isinstance(member, Member) or catalogue.wants(member)


@pytest.fixture(scope="session")
def catalogue(request: pytest.FixtureRequest) -> Catalogue:
    """The plug-ins under test."""
    return request.config.stash[CATALOGUE]


@pytest.fixture(scope="module", params=list(WORLDS.values()), ids=list(WORLDS))
def world(request: pytest.FixtureRequest) -> World:
    """The plane and space in turn."""
    world: World = request.param
    return world


@pytest.fixture(scope="module")
def backend(catalogue: Catalogue, member: Member, world: World) -> Backend:
    """The backend under test with settings that suit the world."""
    distance = f"registration.max_correspondence_distance={world.distance}"
    backend: Backend = catalogue.build(member, distance, "registration.voxel_size=0.0")
    if world.name not in backend.dimensions:
        pytest.skip(f"{member} is for {', '.join(backend.dimensions)} only")
    return backend


@pytest.fixture(scope="module")
def registers(backend: Backend, member: Member) -> Backend:
    """The same, where it registers at all: a baseline cannot be right."""
    if backend.is_baseline:
        pytest.skip(f"{member} is a baseline (is_baseline = True): it need not find the motion")
    return backend
