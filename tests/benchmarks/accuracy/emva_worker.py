"""Runs in an environment of its own, with emva1288: frames as .npy files in, EMVA's numbers as JSON out.

``python emva_worker.py FOLDER``; the folder holds ``images.json``: kind -> exposure -> photons -> files, as emva1288 takes it.
"""

import json
import sys
from pathlib import Path

import numpy as np
from emva1288.process.data import Data1288
from emva1288.process.loader import LoadImageData
from emva1288.process.results import Results1288


def keyed(images):
    """JSON has no numbers for keys."""
    return {
        kind: {float(t): {float(p): files for p, files in levels.items()} for t, levels in exposures.items()}
        for kind, exposures in images.items()
    }


def main(folder: Path) -> None:
    images = keyed(json.loads((folder / "images.json").read_text()))
    loaded = LoadImageData(images, str(folder), fload=np.load)
    found = Results1288(Data1288(loaded.data).data, pixel_area=30.25, loglevel=40)
    names = ("K", "sigma_d", "u_e_sat", "SNR_max_dB", "DR_dB", "DSNU1288", "PRNU1288")
    values = {name: getattr(found, name) for name in names}
    print(json.dumps({name: float(value() if callable(value) else value) for name, value in values.items()}))


if __name__ == "__main__":
    main(Path(sys.argv[1]))
