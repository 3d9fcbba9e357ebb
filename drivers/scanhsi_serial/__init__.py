"""Serial ports as every driver on one needs them: opened for it alone, never blocking the event loop, errors of the tree.

For the drivers of this project and whoever likes it; a driver of yours need not use it.
"""

from scanhsi_serial.errors import lost_error, open_error
from scanhsi_serial.port import close_port, open_port

__all__ = ["close_port", "lost_error", "open_error", "open_port"]
