"""The rig as a scene of Foxglove's 3D panel: coil with core, ball, and the twin's ball, translucent.  Pure.

The frame is the board's name, in metres: z up, origin where the ball touches the lower stop, so a ball at x has its
centre at x + radius.  Travel and ball are those of the plant card; the coil's size is a proportion of the picture.

Rule 1: each update is whole, coil included: after a seek Foxglove has the last message alone.
Rule 2: an object that is not renewed vanishes (`LIFETIME_S`): a ball of an hour ago must not look like one in flight.
"""

from __future__ import annotations

from functools import partial

from foxglove.messages import (
    Color,
    CylinderPrimitive,
    Duration,
    Pose,
    Quaternion,
    SceneEntity,
    SceneUpdate,
    SpherePrimitive,
    TextPrimitive,
    Timestamp,
    Vector3,
)
from google.protobuf.message import Message

from gateway.board.emulated import CE152
from protocol.bus import board51_pb2 as pb
from protocol.bus.plant_card import card_plant
from protocol.plant import steel_ball_m

PERIOD_NS = 40_000_000  # 25 Hz: a picture is smooth, and a hundredth of the samples' bytes
LIFETIME_S = 1
_LATEST_S = (1 << 32) - 1  # of Foxglove's messages: February 2106
TWIN_AGE_S = 0.5  # an older sample of the twin is not drawn
_COIL, _CORE, _PLATE = (
    Color(r=0.72, g=0.45, b=0.2, a=0.5),
    Color(r=0.35, g=0.35, b=0.4, a=1.0),
    Color(r=0.5, g=0.5, b=0.5, a=0.6),
)
_BALL, _TWIN = Color(r=0.75, g=0.78, b=0.82, a=1.0), Color(r=1.0, g=0.5, b=0.05, a=0.4)


class Scene:
    """The picture of one rig."""

    def __init__(self, frame: str) -> None:
        self._frame = frame
        self._slot: int | None = None
        self._twin: pb.TwinState | None = None
        self._use_card(None)

    def take(self, message: Message, time_ns: int) -> SceneUpdate | None:
        """Process a message of the rig in order; return an update where a State makes one due."""
        match message:
            case pb.PlantCard():
                self._use_card(message)
            case pb.TwinState():
                self._twin = message
            case pb.State() if self._is_due(time_ns):
                return self._update(message, timestamp_of(time_ns))
        return None

    def _use_card(self, card: pb.PlantCard | None) -> None:
        stated = card_plant(card)
        plant = stated or CE152
        self._diameter_m = plant.ball_diameter_m or steel_ball_m(plant.mass_kg)
        d, face_m = self._diameter_m, plant.travel_m + self._diameter_m  # at the upper stop the ball touches the core
        self._fixed = [
            _cylinder(0.8 * d, face_m, 2.0 * d, _CORE),
            _cylinder(2.2 * d, face_m + 0.1 * d, 1.7 * d, _COIL),
            _cylinder(2.2 * d, -0.1 * d, 0.1 * d, _PLATE),
        ]
        note = f"ball {d * 1e3:.3g} mm, travel {plant.travel_m * 1e3:.3g} mm"
        self._note = TextPrimitive(
            pose=_at(face_m + 2.2 * d), billboard=True, font_size=0.3 * d, color=Color(r=0.5, g=0.5, b=0.5, a=1.0),
            text=note if stated else f"assumed: {note}",
        )  # fmt: skip

    def _is_due(self, time_ns: int) -> bool:
        # By slots, not by the time since the last: time jumps back where a replay begins again.
        last, self._slot = self._slot, time_ns // PERIOD_NS
        return self._slot != last

    def _update(self, state: pb.State, stamp: Timestamp) -> SceneUpdate:
        entity = partial(SceneEntity, timestamp=stamp, frame_id=self._frame, lifetime=Duration(LIFETIME_S))
        entities = [entity(id="coil", cylinders=self._fixed, texts=[self._note])]
        if state.HasField("x_m"):
            entities.append(entity(id="ball", spheres=[self._ball(state.x_m, _BALL)]))
        twin = self._twin
        if twin is not None and twin.session == state.session and abs(state.t_s - twin.t_s) < TWIN_AGE_S:
            entities.append(entity(id="twin", spheres=[self._ball(twin.x_m, _TWIN)]))
        return SceneUpdate(entities=entities)

    def _ball(self, x_m: float, color: Color) -> SpherePrimitive:
        d = self._diameter_m
        return SpherePrimitive(pose=_at(x_m + d / 2), size=Vector3(x=d, y=d, z=d), color=color)


def _at(z_m: float) -> Pose:
    return Pose(position=Vector3(z=z_m), orientation=Quaternion(w=1.0))


def _cylinder(diameter_m: float, bottom_m: float, height_m: float, color: Color) -> CylinderPrimitive:
    return CylinderPrimitive(
        pose=_at(bottom_m + height_m / 2), size=Vector3(x=diameter_m, y=diameter_m, z=height_m), bottom_scale=1.0,
        top_scale=1.0, color=color,
    )  # fmt: skip


def timestamp_of(time_ns: int) -> Timestamp:
    """Return a Unix time as Foxglove's; one that it cannot express, which no clock of a rig gives, as its latest."""
    return Timestamp(min(time_ns // 10**9, _LATEST_S), time_ns % 10**9)
