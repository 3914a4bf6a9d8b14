"""Tests in another order: the same for the same number, on every worker, and a file's tests together."""

from itertools import groupby
from pathlib import Path

import pytest

pytest_plugins = ["pytester"]

FILES = {f"test_{name}": "".join(f"def test_{number}(): pass\n" for number in range(9)) for name in "abcdef"}


@pytest.fixture(autouse=True)
def _files(pytester: pytest.Pytester, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PYTEST_DISABLE_PLUGIN_AUTOLOAD", "1")
    pytester.makepyfile(**FILES)


def collected(pytester: pytest.Pytester, *options: str) -> list[str]:
    result = pytester.runpytest_inprocess(
        "-p", "tests.plugins.order", "-p", "no:cacheprovider", "--collect-only", "-q", *options
    )
    assert result.ret == pytest.ExitCode.OK
    return [line for line in result.outlines if "::" in line]


def test_without_a_number_the_order_is_that_of_the_files(pytester: pytest.Pytester) -> None:
    found = collected(pytester)
    assert found == sorted(found)
    assert len(found) == 54


def test_a_number_gives_one_order_of_all_tests(pytester: pytest.Pytester) -> None:
    found = collected(pytester, "--order-seed", "17")
    assert found == collected(pytester, "--order-seed", "17")
    assert found != collected(pytester, "--order-seed", "18")
    assert sorted(found) == collected(pytester)


def test_files_and_their_tests_are_shuffled_and_a_file_stays_whole(pytester: pytest.Pytester) -> None:
    files = [
        (name, list(tests)) for name, tests in groupby(collected(pytester, "--order-seed", "17"), lambda one: one[:9])
    ]
    assert len(files) == len(FILES)
    assert [name for name, _ in files] != sorted(name for name, _ in files)
    assert all(tests != sorted(tests) for _, tests in files)


def test_the_report_says_how_an_order_is_had_again(pytester: pytest.Pytester) -> None:
    result = pytester.runpytest_inprocess("-p", "tests.plugins.order", "-p", "no:cacheprovider", "--order-seed", "17")
    result.stdout.fnmatch_lines(["order: --order-seed 17"])


def test_workers_agree_on_the_order(pytester: pytest.Pytester, monkeypatch: pytest.MonkeyPatch) -> None:
    """Otherwise xdist refuses to run anything."""
    monkeypatch.setenv("PYTHONPATH", str(Path(__file__).parents[2]))
    result = pytester.runpytest_subprocess(
        "-p", "xdist", "-p", "tests.plugins.order", "-n", "2", "--dist", "worksteal", "--order-seed", "17"
    )
    result.assert_outcomes(passed=54)
