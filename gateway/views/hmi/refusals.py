"""The refusal of a request by this server: raised where it is found, answered in one place."""

from __future__ import annotations

from starlette.requests import Request
from starlette.responses import JSONResponse

from protocol.bus import board51_pb2 as pb


class RefusalError(Exception):
    """Says why a request is not done.

    Args:
        reason: kebab-case, stable.
        text: A sentence.
        status: of HTTP; that of an act follows from its reason, see acts.py.
        remedy: What to do, where it is not the one of the reason in problems.py.
    """

    def __init__(self, reason: str, text: str, *, status: int = 409, remedy: str = "") -> None:
        super().__init__(text)
        self.reply = pb.CommandReply(refused_by="hmi", reason=reason, text=text)
        self.status, self.remedy = status, remedy


def refusal(status: int, reason: str, text: str) -> JSONResponse:
    """Return the answer of a refused request."""
    return JSONResponse({"accepted": False, "refused_by": "hmi", "reason": reason, "text": text}, status_code=status)


async def refused(_: Request, error: Exception) -> JSONResponse:
    """Answer a request whose endpoint has raised a RefusalError."""
    assert isinstance(error, RefusalError)
    return refusal(error.status, error.reply.reason, error.reply.text)
