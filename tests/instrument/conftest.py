"""The spare drivers instead of the installed ones."""

import pytest

import scanhsi.devices.registry
from support import spare_drivers


@pytest.fixture
def spares(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(scanhsi.devices.registry, "entry_points", spare_drivers.spare_entry_points)
    spare_drivers.JOURNAL.clear()
    spare_drivers.Spare.opened.clear()
