"""What to measure beside the board where its own recordings cannot tell two causes apart: a table of words."""

from __future__ import annotations

from twin.model.causes.catalogue import BY_NAME

_SHIM = (
    "put the ball on its rest, then on a shim of known thickness, and compare the readings of x with the caliper's:"
    " what is wrong there is the sensor's, not the force law's"
)
_CLAMP_METER = (
    "measure the coil's current with a clamp meter while the board reads i_c, at u_c = 0 and at one large input:"
    " what the meter sees flows, what only the board sees is its sensor's"
)
_OSCILLOSCOPE = (
    "trigger an oscilloscope on the board's output pin and look at the coil's current with a probe of its own:"
    " what passes until it moves is the actuator's, the rest of the delay the sampling's"
)
_SCALE = (
    "hang the ball from a scale under the coil and read the pull at constant currents and heights:"
    " the force law alone, without motion and without the position sensor"
)
_UNPLUGGED = (
    "unplug the coil and weigh the ball under it: what still pulls is magnetism or another force, what is gone came"
    " through the amplifier; then demagnetise the core with a dying alternating current and weigh again"
)
_TABLE = {
    frozenset(pair): words
    for words, pairs in (
        (_OSCILLOSCOPE, (("actuation-delay", "sampling-delay"), ("actuation-delay", "position-sensor-lag"),
                         ("eddy-current-lag", "actuation-delay"))),
        (_SHIM, (("air-gap-offset", "position-sensor-offset"), ("air-gap-offset", "position-sensor-gain"),
                 ("force-exponent", "position-sensor-offset"), ("force-exponent", "position-sensor-gain"),
                 ("air-gap-offset", "position-sensor-nonlinearity"),
                 ("force-exponent", "position-sensor-nonlinearity"),
                 ("position-sensor-offset", "constant-force"), ("position-sensor-offset", "sensor-crosstalk"),
                 ("position-sensor-gain", "position-sensor-nonlinearity"))),
        (_CLAMP_METER, (("amplifier-offset", "current-sensor-offset"), ("amplifier-dead-zone", "current-sensor-offset"),
                        ("residual-magnetism", "current-sensor-offset"),
                        ("current-limit", "current-sensor-gain"), ("amplifier-gain-drift", "current-sensor-gain"))),
        (_SCALE, (("air-gap-offset", "force-exponent"), ("core-saturation", "force-exponent"),
                  ("core-saturation", "air-gap-offset"), ("air-gap-offset", "constant-force"),
                  ("force-exponent", "constant-force"))),
        (_UNPLUGGED, (("residual-magnetism", "constant-force"), ("residual-magnetism", "amplifier-offset"),
                      ("amplifier-offset", "constant-force"))),
    )
    for pair in pairs
}  # fmt: skip


def measurement_for(own: str, rival: str) -> str:
    """The measurement that tells the two apart; where nobody has thought of one, what confirms either by hand."""
    known = _TABLE.get(frozenset((own, rival)))
    if known is not None:
        return known
    return f"for {own}: {BY_NAME[own].confirm}; for {rival}: {BY_NAME[rival].confirm}"
