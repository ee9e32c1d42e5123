"""What the tests share: where real data may lie, and reproducible hypothesis runs."""

from __future__ import annotations

import os
from pathlib import Path

import pytest
from hypothesis import HealthCheck, settings

settings.register_profile(
    "graspmap",
    deadline=None,  # the machines that run this are shared
    max_examples=100,
    derandomize=True,
    suppress_health_check=[HealthCheck.too_slow, HealthCheck.function_scoped_fixture],
)
settings.load_profile("graspmap")

DATA = Path(
    os.environ.get("GRASPMAP_TEST_DATA", Path(__file__).parents[2] / "shared" / "data")
).resolve()


@pytest.fixture(scope="session", autouse=True)
def own_cache(tmp_path_factory):
    """What an earlier version of the code kept must not answer for this one."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("GRASPMAP_CACHE", str(tmp_path_factory.mktemp("kept")))
        yield


@pytest.fixture(scope="module")
def one_thread():
    """PyTorch on one thread: on a busy machine, threads that wait for each other take minutes."""
    import torch

    before = torch.get_num_threads()
    torch.set_num_threads(1)
    yield
    torch.set_num_threads(before)


@pytest.fixture(scope="module")
def cache(tmp_path_factory) -> Path:
    """Folder for what is made once and used by all tests of a module: packed pictures, pieces."""
    return tmp_path_factory.mktemp("cache")


@pytest.fixture(scope="session")
def data_dir() -> Path:
    """Folder with real data of others; tests that need it are skipped without it."""
    if not DATA.is_dir():
        pytest.skip(f"no real data at {DATA}; set GRASPMAP_TEST_DATA to run this test")
    return DATA


@pytest.fixture(scope="session")
def generated(tmp_path_factory) -> Path:
    """Three generated scenes of boxes in Jacquard's layout; tests that change them copy them."""
    from graspmap.generation import generate
    from graspmap.generation.plan import GenerationPlan
    from graspmap.gripper import load_gripper

    root = tmp_path_factory.mktemp("generated")
    gripper = load_gripper("jacquard")
    plan = GenerationPlan(3, gripper, views=1, size_px=128, candidates=40, families=("box",))
    generate(plan, root, workers=0)
    return root
