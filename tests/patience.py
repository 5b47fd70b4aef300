"""The time that a test waits for an event that must come: a guard against hanging for ever, never a measure of speed.

Waiting ends with the event, so a long guard costs a healthy test nothing, and a machine with six times as much to do as
it has cores for does not fail it.  How fast something is belongs into `tests/bench`.
"""

HANG_S = 120.0
HANG_MS = 1e3 * HANG_S

# A job of a page has a lower priority than the tests (gateway/processes/child.py): a seventh of a core where these fill
# all of them.
WORK_S = 1200.0
WORK_MS = 1e3 * WORK_S
