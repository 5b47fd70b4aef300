"""Faults of a board: their names and texts.

Rule: a fault of COIL_FAULTS is one that the board cannot end.  No text about it says that the coil is off.
"""

from __future__ import annotations

from protocol.wire.messages import COIL_FAULTS, FAULT_EVENTS, EventCode


def name_of(code: EventCode) -> str:
    """Return the name of an event on the bus, such as `output-fault`."""
    return code.name.lower().replace("_", "-")


COIL_MAY_BE_ON = "THE COIL MAY BE ON: cut its supply."
OUTPUT_UNCONFIRMED = "The converter of u_c does not confirm what the board writes. " + COIL_MAY_BE_ON
FAULT = "fault"  # of an unknown kind: its event was lost, or came before this gateway or view
FAULT_TEXT = "A fault is active: the board has ordered the coil off. Set a mode to clear it."
OUTPUT_FAULT = name_of(EventCode.OUTPUT_FAULT)
COIL = frozenset(map(name_of, COIL_FAULTS))
BOARD_FAULTS = frozenset(map(name_of, FAULT_EVENTS)) | {FAULT}
