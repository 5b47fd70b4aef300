"""The measurements with another instrument that separate two causes if the board's recordings cannot."""

from __future__ import annotations

SHIM = (
    "put the ball on its rest, then on a shim of known thickness, and compare the readings of x with the caliper's:"
    " what is wrong there is the sensor's, not the force law's"
)
CLAMP_METER = (
    "measure the coil's current with a clamp meter while the board reads i_c, at u_c = 0 and at one large input:"
    " what the meter sees flows, what only the board sees is its sensor's"
)
OSCILLOSCOPE = (
    "trigger an oscilloscope on the board's output pin and look at the coil's current with a probe of its own:"
    " what passes until it moves is the actuator's, the rest of the delay the sampling's"
)
SCALE = (
    "hang the ball from a scale under the coil and read the pull at constant currents and heights:"
    " the force law alone, without motion and without the position sensor"
)
UNPLUGGED = (
    "unplug the coil and weigh the ball under it: what still pulls is magnetism or another force, what is gone came"
    " through the amplifier; then demagnetise the core with a dying alternating current and weigh again"
)
