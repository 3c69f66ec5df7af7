"""A browser for the tests of pages, and a client of a sensing node."""

import shutil
from collections.abc import Callable, Iterator
from contextlib import closing
from typing import Any

import pytest

from tests.support.browser import Visit
from tests.support.sensing_client import Client

CHROMIUM = shutil.which("chromium")


@pytest.fixture(scope="module")
def browser() -> Iterator[Any]:
    if CHROMIUM is None:
        pytest.skip("there is no chromium")
    playwright = pytest.importorskip("playwright.sync_api", reason="there is no playwright")
    with playwright.sync_playwright() as driver:
        # As root, chromium has no sandbox.
        browser = driver.chromium.launch(executable_path=CHROMIUM, args=["--no-sandbox"])
        yield browser
        browser.close()


@pytest.fixture
def visit(browser: Any) -> Iterator[Callable[..., Any]]:
    """Provide a function that opens a page; the test fails on errors or requests elsewhere."""
    visit = Visit(browser)
    yield visit
    assert visit.wrong == []


@pytest.fixture
def client(address: str) -> Iterator[Client]:
    with closing(Client(address)) as client:
        yield client
