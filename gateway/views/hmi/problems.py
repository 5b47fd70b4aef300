"""Errors of the API: {"code", "message", "remedy"}.

Rule: a code that the gateway, the board, the twin or a view gives as a reason has its remedy here, so that a program's
user knows the next step without our documentation.
"""

from __future__ import annotations

import json
from collections.abc import Mapping

from starlette.responses import Response

_ANEW = "Send it again if it is still needed"
_LATER = "Try again in a second"
_RUN = "See the alarms and the link of the rig: GET /api/v1/rigs/RIG"
REMEDIES: Mapping[str, str] = {
    # of this server
    "host": "Use http://127.0.0.1",
    "origin": "Send requests from a program, or from a page of this server",
    "session": "Send the header Authorization: Bearer TOKEN; `board51 security add-token` makes a token",
    "session-over": "Send it again",
    "token": "Send the header Authorization: Bearer TOKEN",
    "oversize": "Send less at once",
    "malformed": "See the description of the request at /api/v1/",
    "method": "Use a method that the header Allow names",
    "no-path": "See the list at /api/v1/",
    "media-type": "Send JSON, or a form with Content-Type: application/x-www-form-urlencoded",
    "no-sample": _RUN,
    "no-capture": "Send the command capture; its samples take up to 10 s to come",
    "no-result": "Start its job first: POST /api/v1/rigs/RIG/jobs",
    "no-design": "Start a job design first",
    "too-many": "Close a stream that nobody reads",
    "internal": "See the output of board51 hmi, and report it",
    "no-board": "Take a name of GET /api/v1/rigs",
    "no-log": "Take a name of GET /api/v1/logs",
    "no-model": "Take a name of GET /api/v1/rigs/RIG/models",
    "no-campaign": "Take a name of GET /api/v1/rigs/RIG/campaigns",
    "no-alarm": "Take a name among the alarms of GET /api/v1/rigs/RIG",
    "busy": "Wait until the job has ended, or interrupt it",
    "not-running": "Start it first",
    "failed": "Correct the cause on the machine of this server",
    # of the gateway, the board and the link
    "not-allowed": "Use a token of a user with that role",
    "not-delivered": _RUN,
    "not-fresh": f"{_ANEW}; set the clocks of all machines if it happens again",
    "superseded-by-stop": _ANEW,
    "board-reset": "Read the state, then send it again if it is still needed",
    "disconnected": "Read the state, then send it again if it is still needed",
    "timed-out": "Read the state, then send it again; check the line to the board",
    "link-down": _RUN,
    "out-of-range": "Give a value within the limits that the message names",
    "not-finite": "Give a finite number",
    "slew": "Move the reference in smaller steps",
    "implausible": "Correct the value that the message names",
    "not-confirmed": 'Correct the value, or add "confirmed": true if it is right',
    "wrong-mode": 'Set the mode that the command needs first: {"command": "mode", "mode": "closed-loop"}',
    "fault-active": "Remove the cause of the fault; the command mode then clears it",
    "not-available": "Use a board or firmware that supports the command",
    "queue-full": _LATER,
    "flood": "Send fewer commands: at most 100 in a second",
    "bad-id": "Leave out the id",
    "bad-who": "Use a user's name of letters, digits, - and _",
    "id-reused": "Leave out the id",
    "empty-command": "Name a command",
    "internal-error": "See the log of the gateway, and report it",
    "unknown-type": "Flash the firmware that belongs to this gateway",
    "bad-length": "Flash the firmware that belongs to this gateway",
    "version": "Flash the firmware that belongs to this gateway",
    "no-session": _LATER,
}


def remedy_of(code: str) -> str:
    """Return the next step after a refusal with this code."""
    return sentence(REMEDIES.get(code, "Do what the message says"))


def sentence(text: str) -> str:
    """Return a text with its full stop, so that clients can put message and remedy after each other."""
    return text if not text or text.endswith((".", "!", "?")) else f"{text}."


def problem(status: int, code: str, message: str, *, remedy: str = "", **more: object) -> Response:
    """Return the answer of a request that failed; `more` are further keys of its body.

    ASCII: a name in a request may hold what no encoding has.
    """
    body = {"code": code, "message": sentence(message), "remedy": sentence(remedy) or remedy_of(code), **more}
    return Response(json.dumps(body), status, media_type="application/json")
