"""``python -m scanhsi.service``: the OpenAPI description, as it is committed in ``docs/reference/openapi.json``."""

import json
import sys

from scanhsi.service.app import description

sys.stdout.write(json.dumps(description(), indent=1, ensure_ascii=False) + "\n")
