"""Threads of the workers, the order of files, and fixtures shared by all tests."""

import gc
import os
import random
import sys
from pathlib import Path

import pytest

import tests.any_processor  # noqa: F401  (before numpy)

pytest_plugins = ["slipmap.diagrams.testing.pytest_plugin"]

# Before numpy and numba are loaded: two workers have two cores. With BLAS threads that wait for each other,
# a diagnosis took 19 times as long on a machine that had something else to do.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
if "PYTEST_XDIST_WORKER" in os.environ:
    os.environ.setdefault("NUMBA_NUM_THREADS", "1")

# Where Python may not keep bytecode, each of some hundred processes would compile the same modules again.
sys.dont_write_bytecode = False
os.environ.pop("PYTHONDONTWRITEBYTECODE", None)

# Nearly all that is imported and collected stays: looking for garbage took a quarter of the collection.
# `pytest_collection_finish` goes on with it, as rarely as the command does.
gc.disable()

# Which take longest, one or few tests each. Begun last, they would keep one worker while the other has
# nothing left to do; by itself, xdist begins files with few tests last. The first two compile most kernels,
# each on one worker: what runs on a station comes after those that run on none.
COSTLY = (
    "test_missing_effect.py",
    "test_explore.py",
    "test_diagnose.py",
    "test_two_effects.py",
    "test_generator.py",
    "test_station_hides_an_effect.py",
    "test_notebooks.py",
    "test_pregrasp_loop.py",
    "test_recorded_outputs.py",
    "test_front_door.py",
)

# Where kernels are not compiled yet, the first file compiles those of the model. Meanwhile the other worker
# runs what needs none of them, and first compiles those of pictures; elsewhere both would compile the same.
COMPILES, COMPILES_QUICK = COSTLY[0], "test_effect_derivatives.py"
WITHOUT_KERNELS = ("diagrams/perception", "models/perception", "models/measurements", "models/objects")
WITH_KERNELS_ALL_THE_SAME = (
    "test_dataset_check.py",
    "test_lab_session.py",
    "test_openings.py",
    "test_simulated.py",
)

# What `--quick` leaves out: plants, twins, browsers, notebooks, many processes, and long computations.
NOT_QUICK_FOLDERS = (
    "diagrams/execution", "diagrams/station", "diagrams/testing", "hardware", "notebooks", "recorded",
)  # fmt: skip
NOT_QUICK_FILES = (
    *COSTLY,
    "test_audit.py",
    "test_belief_coverage.py",
    "test_benchmark.py",
    "test_blind_test.py",
    "test_built_in_engines.py",
    "test_campaign_command.py",
    "test_collectable.py",
    "test_command_line.py",
    "test_compare.py",
    "test_comparison.py",
    "test_contact_depth.py",
    "test_diagnosis_report.py",
    "test_effect_files.py",
    "test_effect_fit.py",
    "test_effects_page.py",
    "test_example.py",
    "test_explore_stopped.py",
    "test_explore_study.py",
    "test_figures.py",
    "test_goals.py",
    "test_hostile_effect_files.py",
    "test_hostile_files.py",
    "test_identification.py",
    "test_import_command.py",
    "test_installed.py",
    "test_lab_session.py",
    "test_methods_compared.py",
    "test_mixture.py",
    "test_neighbours.py",
    "test_one_answer.py",
    "test_other_engines.py",
    "test_paper_pictures.py",
    "test_plant_world.py",
    "test_pose_tracking.py",
    "test_pregrasp.py",
    "test_push_listener.py",
    "test_run_folder.py",
    "test_running.py",
    "test_simulator_models.py",
    "test_sizes.py",
    "test_support_on_datasets.py",
    "test_threads.py",
    "test_together_words.py",
    "test_twin_and_interface.py",
    "test_view.py",
    "test_workers.py",
    "test_world.py",
)
NOT_QUICK_FIXTURES = {"browser", "cell", "renderer"}

TESTS = Path(__file__).resolve().parent
SHARED_DATA = TESTS.parents[1] / "shared" / "data"


def pytest_addoption(parser: pytest.Parser) -> None:
    """A random order, which finds tests that need another one before them; and a quick part of the tests."""
    parser.addoption("--quick", action="store_true", help="leave out what takes long; see NOT_QUICK")
    parser.addoption(
        "--shuffle", type=int, metavar="SEED", help="run files, and tests within each, in random order"
    )


def pytest_configure(config: pytest.Config) -> None:
    """Let xdist keep the order below."""
    if hasattr(config.option, "loadscopereorder"):
        config.option.loadscopereorder = False


def pytest_ignore_collect(collection_path: Path, config: pytest.Config) -> bool | None:
    """With --quick, what is left out is not even imported."""
    if not config.getoption("--quick"):
        return None
    folders = {TESTS / folder for folder in NOT_QUICK_FOLDERS}
    return True if collection_path in folders or collection_path.name in NOT_QUICK_FILES else None


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Costly files early, most others as collected; or all at random, file by file."""
    if config.getoption("--quick"):
        left_out = [item for item in items if not NOT_QUICK_FIXTURES.isdisjoint(item.fixturenames)]
        config.hook.pytest_deselected(items=left_out)
        items[:] = [item for item in items if item not in left_out]
    seed = config.getoption("--shuffle")
    if seed is not None:
        draw = random.Random(seed)
        files = {path: draw.random() for path in sorted({item.path for item in items})}
        items.sort(key=lambda item: (files[item.path], draw.random()))
        return
    first = COMPILES_QUICK if config.getoption("--quick") else COMPILES
    items.sort(key=lambda item: _rank(item.path, first))


def pytest_collection_finish(session: pytest.Session) -> None:
    """Look for garbage from now on; note which kernels ran at import, as all workers would compile them."""
    gc.freeze()
    gc.set_threshold(50_000)
    gc.enable()
    kernels = vars(sys.modules.get("slipmap.models.physics.kernel", object))
    ran = [name for name, thing in kernels.items() if getattr(thing, "signatures", None)]
    session.config.ran_at_collection = ran


def _rank(path: Path, first: str) -> int:
    """Place of a file: the one that compiles, those that need no kernels, the costly ones, all others."""
    if path.name == first:
        return -1 - len(WITHOUT_KERNELS)
    if path.name in COSTLY:
        return COSTLY.index(path.name)
    for place, folder in enumerate(WITHOUT_KERNELS, -len(WITHOUT_KERNELS)):
        if path.is_relative_to(TESTS / folder) and path.name not in WITH_KERNELS_ALL_THE_SAME:
            return place
    return len(COSTLY)


@pytest.fixture(scope="session")
def renderer() -> None:
    """A renderer of pictures; tests that need one skip where there is none, and say what is missing."""
    # Drake takes two seconds to load, and the tests of `models` do without.
    from slipmap.diagrams.perception.renderer import RendererUnavailable, require_renderer

    try:
        require_renderer()
    except RendererUnavailable as reason:
        pytest.skip(str(reason))


@pytest.fixture
def shared_data() -> Path:
    """Folder of measured pushes that lies beside the checkout; tests that need it skip where it is absent."""
    if not SHARED_DATA.is_dir():
        pytest.skip(f"no measured pushes at {SHARED_DATA}; they are not part of the project")
    return SHARED_DATA
