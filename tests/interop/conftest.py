from pathlib import Path

import pytest

from support.interop import CODECS, Written, write_for_all


@pytest.fixture(scope="session", params=CODECS)
def written(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Written:
    path: Path = tmp_path_factory.mktemp("interop") / f"{request.param}.zarr"
    return write_for_all(path, request.param)
