"""A run that skips anything fails, and every run says where it ran."""

import pytest

pytest_plugins = ["pytester"]


@pytest.fixture(autouse=True)
def _only_our_plugin(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PYTEST_DISABLE_PLUGIN_AUTOLOAD", "1")


def run(pytester: pytest.Pytester, source: str) -> pytest.RunResult:
    pytester.makepyfile(source)
    return pytester.runpytest_inprocess("-p", "tests.plugins.run_report", "-p", "no:cacheprovider")


def test_a_clean_run_passes_and_names_kernel_and_broker(pytester: pytest.Pytester) -> None:
    result = run(pytester, "def test_true(): assert True")
    assert result.ret == pytest.ExitCode.OK
    result.stdout.fnmatch_lines(["kernel: Linux *; broker: *; skipped: 0"])


@pytest.mark.parametrize(
    "source",
    [
        "import pytest\ndef test_skip(): pytest.skip('not here')",
        "import pytest\n@pytest.mark.skip\ndef test_skip(): pass",
        "import pytest\npytest.skip('not here', allow_module_level=True)",
        "import pytest\npytest.importorskip('a_module_that_does_not_exist')",
    ],
)
def test_a_skip_fails_the_run(pytester: pytest.Pytester, source: str) -> None:
    result = run(pytester, source + "\ndef test_true(): assert True")
    assert result.ret in {pytest.ExitCode.TESTS_FAILED, pytest.ExitCode.NO_TESTS_COLLECTED}
    result.stdout.fnmatch_lines(["*skipped: 1", "skipped, which fails this run: *"])


def test_an_expected_failure_is_not_a_skip(pytester: pytest.Pytester) -> None:
    result = run(pytester, "import pytest\n@pytest.mark.xfail\ndef test_false(): assert False")
    assert result.ret == pytest.ExitCode.OK


def test_a_failure_stays_a_failure(pytester: pytest.Pytester) -> None:
    result = run(pytester, "def test_false(): assert False")
    assert result.ret == pytest.ExitCode.TESTS_FAILED
