"""What a power cut leaves: which of the changes to a folder were synced, and what would be there if only those had survived.

The model is the least that POSIX promises: contents of a file survive once the file was synced, a name once its folder was. What
was not synced may survive as well, and names may survive without their contents: `cut` makes up such cases too.
"""

from __future__ import annotations

import random
import shutil
from dataclasses import dataclass, field
from pathlib import Path

_ROOT = 0


@dataclass
class _Node:
    """A file or folder.

    Attributes:
        names: Of a folder: what is in it now; None for a file.
        synced_names: What was in it when it was last synced.
        synced: Of a file: copy of what it held when it was last synced.
    """

    names: dict[str, int] | None
    synced_names: dict[str, int] = field(default_factory=dict[str, int])
    synced: Path | None = None


class Volatile:
    """Follows the changes to a folder.

    Args:
        backing: The folder, empty now.
        copies: Where to keep contents that were synced.
    """

    def __init__(self, backing: Path, copies: Path) -> None:
        self._backing = backing
        self._copies = copies
        self.forget()

    def forget(self) -> None:
        """The folder is empty again."""
        shutil.rmtree(self._copies, ignore_errors=True)
        self._copies.mkdir()
        self._nodes: dict[int, _Node] = {_ROOT: _Node({})}
        self._count = 0

    def created(self, path: str) -> None:
        folder, name = self._place(path)
        if name not in folder:
            folder[name] = self._new(_Node(None))

    def made(self, path: str) -> None:
        folder, name = self._place(path)
        folder[name] = self._new(_Node({}))

    def renamed(self, old: str, new: str) -> None:
        source, name = self._place(old)
        number = source.pop(name)
        target, name = self._place(new)
        target[name] = number

    def removed(self, path: str) -> None:
        folder, name = self._place(path)
        folder.pop(name)

    def synced(self, path: str) -> None:
        node = self._node(path)
        if node.names is not None:
            node.synced_names = dict(node.names)
            return
        copy = self._copies / str(self._next())
        shutil.copyfile(f"{self._backing}{path}", copy)
        node.synced = copy

    def cut(self, target: Path, how: str, live: Path) -> None:
        """Write what is there after a power cut to a new folder.

        Args:
            target: The folder.
            how: ``least``: what was synced and nothing else. ``names``: all names, and what was synced of their contents. Else a
                seed: some of what was not synced is there too, whole or in part.
            live: What would be there without a power cut.
        """
        rng = random.Random(how)

        def build(number: int, where: Path, now: Path | None) -> None:
            node = self._nodes[number]
            if node.names is None:
                where.write_bytes(self._contents(node, now, how, rng))
                return
            where.mkdir()
            names = node.names if how == "names" or (how != "least" and rng.random() < 0.5) else node.synced_names
            for name, child in names.items():
                there = now / name if now is not None and node.names.get(name) == child else None
                build(child, where / name, there)

        build(_ROOT, target, live)

    def _contents(self, node: _Node, now: Path | None, how: str, rng: random.Random) -> bytes:
        synced = node.synced.read_bytes() if node.synced is not None else b""
        if how in ("least", "names") or now is None or node.synced is not None or rng.random() < 0.3:
            return synced
        whole = now.read_bytes()
        return whole if rng.random() < 0.5 else whole[: len(whole) // 2]

    def _new(self, node: _Node) -> int:
        self._nodes[self._next()] = node
        return self._count

    def _next(self) -> int:
        self._count += 1
        return self._count

    def _node(self, path: str) -> _Node:
        node = self._nodes[_ROOT]
        for name in path.split("/"):
            if name:
                assert node.names is not None
                node = self._nodes[node.names[name]]
        return node

    def _place(self, path: str) -> tuple[dict[str, int], str]:
        parent, _, name = path.rpartition("/")
        names = self._node(parent).names
        assert names is not None
        return names, name
