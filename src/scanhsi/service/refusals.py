"""Why the service refuses, where the instrument itself would not."""

from __future__ import annotations

from typing import Final

from scanhsi.devices.errors import ScanhsiError


class Refused(ScanhsiError):
    """The service refuses a request; nothing was done.

    Attributes:
        status: Of the HTTP answer.
    """

    status: int = 400


class NotInControl(Refused):
    """Somebody else is in control, or nobody."""

    status = 403


class LeaseHeld(Refused):
    """Control is taken, and not stolen."""

    status = 409


class NoSuch(Refused):
    """There is nothing of that name."""

    status = 404


class Conflict(Refused):
    """What is asked does not fit what is going on."""

    status = 409


class Unauthorized(Refused):
    """The token is missing or wrong."""

    status = 401


class CrossSite(Refused):
    """A page of another site sent this."""

    status = 403


class TooLarge(Refused):
    """The body is longer than any request needs."""

    status = 413


class TooSlow(Refused):
    """The body did not come in time."""

    status = 408


class TooMany(Refused):
    """More requests than a person or a script of good will sends."""

    status = 429


class KeyReused(Refused):
    """The idempotency key was used for something else."""

    status = 422


TAKE_CONTROL: Final = "POST /api/v1/lease, and send the id it answers in the header Scanhsi-Lease"
