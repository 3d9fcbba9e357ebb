"""The same frames worked out by emva1288, the reference implementation of the standard, in its own environment (`support.emva`).

What emva1288 1.0.2 said of these very frames is also written down, so that the comparison is made where it is not installed.
"""

import numpy as np
import pytest

from scanhsi.calibration.photon_transfer import FlatPair, photon_transfer
from scanhsi.calibration.result import Provenance
from support.emva import emva1288, emva_python
from support.flats import pairs

SAID = {
    "K": 0.30081217965118034,
    "sigma_d": 12.984551515826015,
    "u_e_sat": 12379.72212257999,
    "SNR_max_dB": 40.92710896543182,
    "DR_dB": 59.23470603616025,
    "DSNU1288": 3.9447349614794405,
    "PRNU1288": 0.9937139144810221,
}


@pytest.fixture(scope="module")
def frames() -> list[FlatPair]:
    return list(pairs(np.random.default_rng(1), 24))


def compare(frames: list[FlatPair], theirs: dict[str, float]) -> None:
    ours = photon_transfer(frames, Provenance())
    assert ours.gain == pytest.approx(theirs["K"], rel=0.001)
    assert ours.read_noise_e == pytest.approx(theirs["sigma_d"], rel=0.002)
    assert ours.saturation_e == pytest.approx(theirs["u_e_sat"], rel=0.001)
    assert ours.snr_max_db == pytest.approx(theirs["SNR_max_dB"], abs=0.01)
    assert ours.dynamic_range_db == pytest.approx(theirs["DR_dB"], abs=0.02)
    assert 100 * ours.prnu == pytest.approx(theirs["PRNU1288"], rel=0.002)
    assert ours.dsnu_e == pytest.approx(theirs["DSNU1288"], rel=0.06)  # theirs of the frames at half saturation


def test_what_emva1288_said_once(frames) -> None:
    compare(frames, SAID)


@pytest.mark.skipif(emva_python() is None, reason="EMVA1288_PYTHON names no environment with emva1288")
def test_what_emva1288_says_now(frames) -> None:
    """It looks for the largest variance from the bright end, where noise of full pixels stops it: two exposures beyond will do."""
    ours = photon_transfer(frames, Provenance())
    half = int(np.argmin(np.abs(ours.signal - ours.signal.max() / 2)))
    compare(frames, emva1288(frames[: int(np.argmax(ours.variance)) + 2], half))
