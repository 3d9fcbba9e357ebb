"""The other half of the scans of the day; see `test_broken_scans`."""

from __future__ import annotations

import pytest

from scanhsi.testing import fuzz
from support.fuzzing import clean

SEED = fuzz.today()


@pytest.mark.parametrize("first", range(500, 1000, 100))
def test_more_scans_of_the_day(first: int) -> None:
    clean(SEED, range(first, first + 100))
