"""The committed firmware is what its source builds to."""

import os
import shutil
import subprocess
from pathlib import Path

import pytest

import scanhsi_stepper

FIRMWARE = Path(scanhsi_stepper.__file__).parent / "firmware"
COMPILER = "avr-gcc (GCC) 5.4.0"  # of Debian 12: another one may build other code that is as right


def test_firmware_rebuilds_to_the_committed_image(tmp_path: Path) -> None:
    if not (shutil.which("avr-gcc") and shutil.which("make")):
        (pytest.fail if "CI" in os.environ else pytest.skip)(
            "to rebuild the firmware: apt-get install gcc-avr binutils-avr avr-libc make"
        )
    version = subprocess.run(["avr-gcc", "--version"], capture_output=True, text=True, check=True).stdout.splitlines()[
        0
    ]
    if version != COMPILER:
        pytest.skip(f"the image was built by {COMPILER}, this is {version}")
    subprocess.run(["make", "-C", FIRMWARE, f"OUT={tmp_path}"], check=True, capture_output=True, env=os.environ)
    for name in ("stepper.hex", "stepper.elf", "grbl.elf"):
        assert (tmp_path / name).read_bytes() == (FIRMWARE / name).read_bytes()


def test_the_image_fits_the_chip() -> None:
    records = (FIRMWARE / "stepper.hex").read_text().split()
    size = sum(int(record[1:3], 16) for record in records if record[7:9] == "00")
    assert 4000 < size < 32_256  # 32 KB less the bootloader
