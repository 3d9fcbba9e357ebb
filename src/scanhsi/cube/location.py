"""Where a cube is: a folder, or a URL of an object store.

Credentials come from the environment, as obstore reads it (``AWS_ACCESS_KEY_ID``, ``AWS_SECRET_ACCESS_KEY``, ``AWS_ENDPOINT_URL``,
``AWS_REGION``, ``AWS_ALLOW_HTTP``; the like for Azure and Google), or from ``storage_options``. What a server or obstore says of an
error may repeat them, so none of it is ever shown: errors here are made of our own words.
"""

from __future__ import annotations

import os
import re
from collections.abc import Generator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from datetime import timedelta
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final
from urllib.parse import unquote, urlsplit

from zarr.abc.store import Store
from zarr.storage import LocalStore

from scanhsi.devices.errors import CubeError, NotACube

if TYPE_CHECKING:
    from obstore.store import ObjectStore as ObstoreStore
    from zarr.storage import ObjectStore

_URL: Final = re.compile(r"[a-zA-Z][a-zA-Z0-9+.-]*://")
_RETRY: Final = {"max_retries": 4, "retry_timeout": timedelta(seconds=30)}
"""obstore's own is ten times in three minutes: too long to tell somebody that an address is wrong."""

_INSTALL: Final = 'pip install "scanhsi[cluster]"'


@dataclass(frozen=True, slots=True)
class Location:
    """Place of a cube. Goes to other processes as it is, with the options but without credentials of the environment.

    Attributes:
        text: Path or URL.
        options: Configuration of the object store, see `locate`. Not shown.
    """

    text: str
    options: Mapping[str, str] = field(default_factory=dict[str, str], repr=False)

    def __str__(self) -> str:
        return self.text

    @property
    def path(self) -> Path | None:
        """The folder, or None where it is a URL."""
        return None if is_url(self.text) else Path(self.text)

    def store(self) -> Store:
        """The place as a store for zarr, to read from.

        Raises:
            CubeError: obstore is missing, or cannot make sense of the URL or its options.
        """
        path = self.path
        return object_store(self) if path is None else LocalStore(path, read_only=True)

    def size_bytes(self) -> int:
        """Bytes of everything that is there.

        Raises:
            CubeError: The object store cannot be listed.
        """
        path = self.path
        if path is not None:
            return sum(_file_bytes(file) for file in path.rglob("*"))
        import obstore

        with remote_errors(self):
            return sum(entry["size"] for batch in obstore.list(object_store(self).store) for entry in batch)


def _file_bytes(file: Path) -> int:
    try:
        return file.stat().st_size if file.is_file() else 0
    except FileNotFoundError:  # a temporary file of the writer, renamed meanwhile
        return 0


def is_url(text: str | Path) -> bool:
    """Whether a place is a URL, not a path."""
    return isinstance(text, str) and _URL.match(text) is not None


def locate(place: str | Path, storage_options: Mapping[str, str] | None = None) -> Location:
    """Make a place out of what a user gave.

    Args:
        place: Path, ``file:///path``, or URL of an object store: ``s3://bucket/cube.zarr``.
        storage_options: Configuration by obstore's names: ``{"endpoint": "https://...", "region": "..."}``. What is not given
            is taken from the environment.

    Raises:
        CubeError: The URL carries credentials or a query, or options were given for a path.
    """
    text = str(place)
    if is_url(place):
        parts = urlsplit(text)
        if parts.scheme.lower() != "file":
            if "@" in parts.netloc or parts.query or parts.fragment:
                raise CubeError(
                    f"the URL of a cube in {parts.scheme}://{parts.netloc.rpartition('@')[2]} has a user, a query or a fragment.",
                    hint="the plain URL, with credentials in the environment (AWS_ACCESS_KEY_ID, AWS_SECRET_ACCESS_KEY)",
                )
            return Location(text.rstrip("/"), dict(storage_options or {}))
        text = unquote(parts.path)
    if storage_options:
        raise CubeError(f"{text} is a folder: storage_options are for URLs.")
    return Location(text)


def object_store(location: Location, *, read_only: bool = True) -> ObjectStore[Any]:
    """Store for zarr at a URL.

    Raises:
        CubeError: As `Location.store`.
    """
    store = raw_store(location)  # tells what to install, before zarr asks for it
    from zarr.storage import ObjectStore

    return ObjectStore(store, read_only=read_only)


def raw_store(
    location: Location, client: Mapping[str, Any] | None = None, retry: Mapping[str, Any] = _RETRY
) -> ObstoreStore:
    """Store of obstore at a URL.

    Args:
        location: The URL.
        client: obstore's client options (timeouts, say).
        retry: obstore's retry configuration.

    Raises:
        CubeError: As `Location.store`.
    """
    try:
        from obstore.exceptions import BaseError
        from obstore.store import from_url
    except ImportError:
        raise CubeError(f"{location} is a URL, and obstore is not installed.", hint=_INSTALL) from None
    options = dict(location.options)
    allowed = (
        options.pop("allow_http", "false").lower() == "true"
    )  # obstore wants it beside the options, and panics in them
    plain = allowed or any(text.startswith("http://") for text in (location.text, options.get("endpoint", "")))
    settings: dict[str, Any] = {**options, "retry_config": dict(retry)}
    if client or plain:
        # where obstore is given any of these, it takes none from the environment
        plain = plain or os.environ.get("AWS_ALLOW_HTTP", "").lower() == "true"
        settings["client_options"] = {**(client or {}), **({"allow_http": True} if plain else {})}
    try:
        return from_url(location.text, **settings)
    except (BaseError, ValueError, TypeError):
        names = f" with the options {sorted(location.options)}" if location.options else ""
        raise CubeError(
            f"obstore cannot use {location}{names}.", hint="s3://bucket/cube.zarr, and options by obstore's names"
        ) from None


@contextmanager
def remote_errors(location: Location) -> Generator[None]:
    """Turn the errors of an object store into ours, without a word of theirs; others pass.

    Raises:
        NotACube: Nothing is there.
        CubeError: The server refuses, does not answer, or answers something else.
    """
    if location.path is not None:
        yield
        return
    from obstore import exceptions

    try:
        yield
    except FileNotFoundError:
        raise NotACube(f"there is no {location}.") from None
    except (exceptions.PermissionDeniedError, exceptions.UnauthenticatedError):
        raise CubeError(
            f"the server refuses to let us read {location}.",
            hint="AWS_ACCESS_KEY_ID, AWS_SECRET_ACCESS_KEY and AWS_REGION in the environment",
        ) from None
    except exceptions.BaseError as error:
        raise CubeError(
            f"{location} cannot be read: {harmless_reason(str(error))}.",
            hint="AWS_ACCESS_KEY_ID, AWS_SECRET_ACCESS_KEY, AWS_REGION and AWS_ENDPOINT_URL (with AWS_ALLOW_HTTP=true for http) "
            "in the environment; from Python also storage_options",
        ) from None


def harmless_reason(text: str) -> str:
    """Why, in words that are known to be harmless."""
    if status := re.search(r"status(?: code)?: (\d{3})", text):
        return f"the server answers with HTTP status {status[1]}"
    lowered = text.lower()
    if "credential" in lowered or "169.254.169.254" in lowered:
        return "no credentials were found"
    if "timed out" in lowered:
        return "the server does not answer in time"
    if "error sending request" in lowered or "connect" in lowered:
        return "no connection to the server"
    return "the object store failed"
