"""The spare drivers instead of the installed ones."""

from collections.abc import Iterator

import pytest

from scanhsi.devices import registry
from support import spare_drivers


@pytest.fixture
def spares(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    monkeypatch.setattr(registry, "entry_points", spare_drivers.spare_entry_points)
    spare_drivers.JOURNAL.clear()
    spare_drivers.Spare.opened.clear()
    registry._points.cache_clear()  # pyright: ignore[reportPrivateUsage]
    yield
    registry._points.cache_clear()  # pyright: ignore[reportPrivateUsage]
