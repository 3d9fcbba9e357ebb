"""A few operations on the objects of an object store, as a cube's writer needs them: conditional, retried, with harmless errors.

Every write says which version of the object it replaces (If-None-Match, If-Match), so whatever a delayed request of somebody else
does, nothing is overwritten that was not seen. A request is tried again when the connection or the server failed, for a bounded
time. Whether a lost answer meant success is told by what is there: the bytes that were to be written, or others.
"""

from __future__ import annotations

import errno
import re
import threading
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from datetime import timedelta
from typing import TYPE_CHECKING, Any, Final, TypeVar

from scanhsi.cube.destination import DestinationError
from scanhsi.cube.location import Location, harmless_reason, raw_store

if TYPE_CHECKING:
    from obstore.store import ObjectStore

T = TypeVar("T")

Version = Mapping[str, str]
"""What identifies the contents of an object (``e_tag``, on some stores ``version``)."""

_NO_RETRY: Final = {"max_retries": 0, "retry_timeout": timedelta(seconds=1)}  # retried here, by our rules
_ATTEMPT_S: Final = 20.0
_SLOWEST_BYTES_PER_S: Final = 250_000
"""A link slower than this counts as broken."""
_PAUSES_S: Final = (0.1, 0.3, 1.0, 2.0, 5.0)

_CREDENTIALS: Final = "AWS_ACCESS_KEY_ID, AWS_SECRET_ACCESS_KEY and AWS_REGION in the environment"
_ADDRESS: Final = (
    "AWS_ENDPOINT_URL (and AWS_ALLOW_HTTP=true for http) in the environment, and whether the server runs; what was stored is "
    "safe, and the scan can be resumed"
)


class Conflict(OSError):
    """An object is not in the version that was to be replaced: somebody else wrote it."""


class Objects:
    """Objects below the URL of a cube. Every method blocks and may be called from several threads.

    Args:
        location: A URL.
        retry_s: How long after the first failure a request is still tried again. Once that was in vain, requests are tried once,
            until one succeeds.

    Raises:
        CubeError: obstore is missing, or cannot make sense of the URL.
    """

    def __init__(self, location: Location, *, retry_s: float = 60.0) -> None:
        self.location = location
        self._retry_s = self._patience_s = retry_s
        self._stores: dict[int, ObjectStore] = {}
        self._reading = raw_store(
            location, {"timeout": timedelta(hours=1), "read_timeout": timedelta(seconds=_ATTEMPT_S)}, _NO_RETRY
        )

    def _store(self, size: int) -> ObjectStore:
        """A client with time enough to send so many bytes. The time of one attempt belongs to the client, not to the request."""
        megabytes = 1 << max(size // 1_000_000, 0).bit_length()
        if megabytes not in self._stores:
            attempt_s = _ATTEMPT_S + megabytes * 1_000_000 / _SLOWEST_BYTES_PER_S
            self._stores[megabytes] = raw_store(self.location, {"timeout": timedelta(seconds=attempt_s)}, _NO_RETRY)
        return self._stores[megabytes]

    def put(
        self, key: str, parts: Sequence[memoryview | bytes], replaces: Version | None, retry_s: float | None = None
    ) -> Version:
        """Write an object whole, in one request: an attempt that is cut short leaves nothing behind, not even hidden parts.

        Args:
            key: Its key.
            parts: Its contents.
            replaces: The version that is there; None where nothing may be there.
            retry_s: Instead of the one for all requests.

        Raises:
            Conflict: Something else is there.
            DestinationError: The server refuses, or cannot be reached.
        """
        import obstore
        from obstore.exceptions import AlreadyExistsError, PreconditionError

        size = sum(memoryview(part).nbytes for part in parts)
        store = self._store(size)
        mode: Any = "create" if replaces is None else dict(replaces)

        def attempt() -> Version:
            try:
                result = obstore.put(store, key, list(parts), mode=mode, use_multipart=False)
            except (AlreadyExistsError, PreconditionError):
                return self._written_already(key, parts)
            return _version(result)

        try:
            return self._retried(attempt, retry_s)
        except FileNotFoundError:
            raise DestinationError(
                errno.ENODEV, f"there is no such bucket, or it cannot be seen: {self.location}", hint="another URL"
            ) from None

    def _written_already(self, key: str, parts: Sequence[memoryview | bytes]) -> Version:
        """The version of an object that has these contents: written by an attempt whose answer was lost."""
        there = self._get_once(key)
        if there is None or there[0] != b"".join(parts):
            raise Conflict(errno.EBUSY, f"{key} was written by somebody else")
        return there[1]

    def get(self, key: str) -> tuple[bytes, Version] | None:
        """Contents and version of an object; None where there is none."""
        return self._retried(lambda: self._get_once(key))

    def _get_once(self, key: str) -> tuple[bytes, Version] | None:
        import obstore

        try:
            result = obstore.get(self._reading, key)
            return bytes(result.bytes()), _version(result.meta)
        except FileNotFoundError:
            return None

    def version(self, key: str) -> Version | None:
        """Version of an object; None where there is none."""
        import obstore

        try:
            return self._retried(lambda: _version(obstore.head(self._store(0), key)))
        except FileNotFoundError:
            return None

    def keys(self, prefix: str) -> list[str]:
        """Keys below a prefix that ends at a ``/`` (not included); all keys for ``""``."""
        import obstore

        store = self._store(0)
        listed: Callable[[], list[str]] = lambda: [  # noqa: E731 a list in a lambda, for its type
            str(entry["path"]) for batch in obstore.list(store, prefix or None) for entry in batch
        ]
        return sorted(self._retried(listed))

    def delete(self, keys: Iterable[str]) -> None:
        """Remove objects; those that are not there do not matter."""
        import obstore

        store = self._store(0)
        names = list(keys)
        if not names:
            return
        try:
            self._retried(lambda: obstore.delete(store, names))
        except FileNotFoundError:
            for name in names:  # a store that tells; the others are still there, perhaps
                if self.version(name) is not None:
                    self._retried(lambda name=name: obstore.delete(store, name))

    def _retried(self, attempt: Callable[[], T], retry_s: float | None = None) -> T:
        from obstore.exceptions import BaseError

        patience_s = self._patience_s if retry_s is None else retry_s
        first: float | None = None
        failures = 0
        while True:
            try:
                result = attempt()
            except FileNotFoundError:
                raise
            except BaseError as error:
                now = time.monotonic()  # this runs in threads, where there is no loop whose time could be asked
                first = now if first is None else first
                pause_s = _PAUSES_S[min(failures, len(_PAUSES_S) - 1)]
                ending = not threading.main_thread().is_alive()
                if ending or not _is_transient(error) or now + pause_s > first + patience_s:
                    if retry_s is None:
                        self._patience_s = 0.0
                    raise self._told(error, now - first) from None
            else:
                self._patience_s = self._retry_s
                return result
            failures += 1
            time.sleep(pause_s)

    def _told(self, error: Exception, waited_s: float) -> DestinationError:
        """An error of obstore in harmless words."""
        from obstore import exceptions

        if isinstance(error, exceptions.PermissionDeniedError | exceptions.UnauthenticatedError):
            return DestinationError(errno.EACCES, "the server refuses it with these credentials", hint=_CREDENTIALS)
        reason = harmless_reason(str(error))
        if "credentials" in reason:
            return DestinationError(errno.EACCES, reason, hint=_CREDENTIALS)
        tried = f", tried for {waited_s:.0f} s" if waited_s >= 1 else ""
        return DestinationError(errno.EREMOTEIO, f"{reason}{tried}", hint=_ADDRESS)


def _version(result: Any) -> Version:
    return {name: result[name] for name in ("e_tag", "version") if result.get(name)}


def _is_transient(error: Exception) -> bool:
    """Whether the same request may succeed later: the connection or the server failed, and nobody refused anything."""
    from obstore import exceptions

    refusals = (
        exceptions.PermissionDeniedError,
        exceptions.UnauthenticatedError,
        exceptions.NotSupportedError,
        exceptions.InvalidPathError,
        exceptions.UnknownConfigurationKeyError,
    )
    if isinstance(error, refusals):
        return False
    text = str(error)
    if status := re.search(r"status(?: code)?: (\d{3})", text):
        return int(status[1]) >= 500 or int(status[1]) in (408, 409, 429)
    return "credential" not in text.lower()
