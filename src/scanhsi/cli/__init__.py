"""The command line, ``scanhsi``: one small module a command.

Modules of commands import what they need inside their functions, so that ``scanhsi --help`` is quick.
"""

from scanhsi.cli.app import main, run

__all__ = ["main", "run"]
