"""A browser for all tests of a file, and a server with its compiled programs."""

import pytest

from benchmarks import browsing


@pytest.fixture(scope="module")
def chromium():
    if browsing.BROWSER is None:
        pytest.skip("no Chromium on this machine (apt-get install chromium); `.ci/run` installs it")
    with browsing.browser() as found:
        yield found


@pytest.fixture(scope="module")
def server():
    with browsing.served() as found:
        yield found


@pytest.fixture
def visit(chromium, server):
    """A page that has its first finished picture; at the end its console must be empty."""
    url, _ = server
    visit = browsing.Visit.of(chromium, f"{url}?size=128")
    visit.final()
    yield visit
    visit.close()
    assert visit.complaints == []
