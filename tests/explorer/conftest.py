"""A browser for all tests of a file, a server with its compiled programs, and its pages."""

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
def opened(chromium, server):
    """A function that opens the page at an address; at the end its console must be empty."""
    visits = []

    def at(query):
        visits.append(browsing.Visit.of(chromium, server[0] + query))
        return visits[-1]

    yield at
    for visit in visits:
        visit.close()
        assert visit.complaints == []


@pytest.fixture
def visit(opened):
    """A page that has its first finished picture."""
    visit = opened("?size=128")
    visit.final()
    return visit
