"""Tests that take long are named by their files, which may be renamed."""

from tests.conftest import (
    COMPILES_QUICK,
    COSTLY,
    NOT_QUICK_FILES,
    NOT_QUICK_FOLDERS,
    TESTS,
    WITH_KERNELS_ALL_THE_SAME,
    WITHOUT_KERNELS,
)


def test_what_is_begun_first_or_left_out_is_there():
    files = {path.name for path in TESTS.rglob("test_*.py")}
    assert {*COSTLY, *NOT_QUICK_FILES, COMPILES_QUICK, *WITH_KERNELS_ALL_THE_SAME} <= files
    assert all((TESTS / folder).is_dir() for folder in (*NOT_QUICK_FOLDERS, *WITHOUT_KERNELS))


def test_no_kernel_is_needed_to_import_the_tests(pytestconfig):
    assert pytestconfig.ran_at_collection == []
