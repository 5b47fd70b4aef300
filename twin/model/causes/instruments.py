"""The measurements with another instrument that separate two causes if the board's recordings cannot."""

from __future__ import annotations

SHIM = (
    "put the ball on its rest, then on a shim of known thickness, and compare the readings of x with the caliper's:"
    " an error there belongs to the sensor, not to the force law"
)
CLAMP_METER = (
    "measure the coil's current with a clamp meter while the board reads i_c, at u_c = 0 and at one large input:"
    " a current that the meter sees flows, and one that only the board sees is an error of its sensor"
)
OSCILLOSCOPE = (
    "trigger an oscilloscope on the board's output pin and look at the coil's current with a probe of its own:"
    " the time until it moves belongs to the actuator, the rest of the delay to the sampling"
)
SCALE = (
    "hang the ball from a scale under the coil and read the pull at constant currents and heights:"
    " the force law alone, without motion and without the position sensor"
)
UNPLUGGED = (
    "unplug the coil and weigh the ball under it: a pull that remains is magnetism or another force, one that is gone"
    " came through the amplifier; then demagnetise the core with a decaying alternating current and weigh again"
)
