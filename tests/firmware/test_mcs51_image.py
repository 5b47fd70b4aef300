"""Checks the demands of the 8051 image on its chip (cycles, memory, stack, baud) and that interrupts cannot harm it."""

from __future__ import annotations

import json
import re
import shutil
import subprocess
from pathlib import Path

import pytest

from firmware.sim.mcs51.board import TICK_CYCLES, Mcs51Board
from firmware.sim.mcs51.build import CLOCK_HZ, actual_baud, image, image_sources
from gateway.emulator.firmware_model.flash import T_S_US
from gateway.emulator.native.board import NativeFirmware
from gateway.emulator.native.flags import flags
from gateway.emulator.plant.levitation import EmulatedPlant
from protocol.wire.decoder import StreamDecoder
from protocol.wire.messages import Message, Value
from tests.harness.firmware.chip_host import ChipHost
from tests.harness.firmware.mcs51_bench import skip_without_sdcc
from tests.harness.gateway.board_host import Bench, frame
from tests.harness.protocol.port import take_output

INTERRUPT_FUNCTIONS = {
    "b51_capture_interrupt",
    "store",
    "convert",
    "b51_hal_read_current",
    "b51_hal_write_input",
    "b51_hal_capture_timer",
}
GAINS = {"law": 0, "i_0": 1304, "x_0": 2034, "u_0": 1756}
GAINS |= {f"k{n}_mantissa": m for n, m in enumerate((25690, 32576, 21199, -21585), 1)}
GAINS |= {f"k{n}_shift": s for n, s in enumerate((17, 14, 11, 19), 1)}
SIGNAL: dict[str, Value] = {
    "target": 1,
    "amplitude": 60,
    "offset": 2000,
    "period": 50,
    "period_end": 10,
    "seed": 85,
    "duration": 100,
}
COMMANDS: list[tuple[str, dict[str, Value]]] = [
    ("PING", {}),
    ("HELLO", {"session": 1, "version_min": 1, "version_max": 1}),
    ("GET_PARAMETERS", {}),
    ("SET_REFERENCE", {"x_ref": 2000}),
    ("SET_GAINS", dict(GAINS)),
    *[("EXCITE", {"shape": shape, **SIGNAL}) for shape in range(7)],
    ("SET_MODE", {"mode": 1}),
    ("CAPTURE", {"u_from": 300, "u_to": 1700, "pre": 40, "count": 240}),
    ("READ_CAPTURE", {"index": 33}),
    ("STOP", {}),
]


@pytest.fixture(autouse=True)
def _installed() -> None:
    skip_without_sdcc()


def play(bus: ChipHost[Mcs51Board], name: str, *, ticks: int = 12, **fields: Value) -> None:
    """Send a command and give the chip time for its answer."""
    bus.send(name, **fields)
    bus.run(ticks)


def flying(plant: EmulatedPlant | None = None, *, slow: bool = False) -> ChipHost[Mcs51Board]:
    """A board in closed loop; slow: cycles are those of the 12T family."""
    board = Mcs51Board(plant or EmulatedPlant(seed=1))
    board.chip.cpu.slow = slow
    bus = ChipHost(board)
    bus.run(40)
    bus.hello()
    play(bus, "SET_MODE", mode=2, ticks=100)
    return bus


def test_a_tick_with_any_command_is_over_before_the_next() -> None:
    """The gate: the law, a STATE, a command and its answer, an interrupt each CAPTURE_US and each byte."""
    bus = flying()
    chip, longest = bus.board.chip, {}
    chip.longest_turn = 0
    bus.run(50)
    assert 5_000 < chip.longest_turn < 0.4 * TICK_CYCLES
    for name, fields in COMMANDS:
        chip.longest_turn = 0
        play(bus, name, ticks=30 if name == "CAPTURE" else 12, **fields)
        longest[name, fields.get("shape")] = chip.longest_turn

    assert max(longest.values()) < TICK_CYCLES, longest
    assert not [m for m in bus.messages if m.name == "EVENT" and m.int("code") == 8]  # OVERRUN
    assert not [m for m in bus.messages if m.name == "NACK"]


class TimedPlant(EmulatedPlant):
    """Notes how long after each conversion the converters or the output are next used, s, in steps of 20 us."""

    def __init__(self) -> None:
        self.after_conversion: list[float] = []
        self._converted = False
        super().__init__(seed=1)

    def sense(self) -> tuple[float, float]:
        self._converted = True
        return super().sense()

    def advance(self, u_v: float, duration_s: float) -> None:
        super().advance(u_v, duration_s)
        if self._converted and duration_s > 100e-6:  # what is shorter is the next conversion
            self.after_conversion.append(duration_s)
        self._converted = False


def test_from_the_position_to_the_input_it_takes_as_long_with_a_signal_as_without() -> None:
    """The signal is computed a tick ahead: a delay that a multisine made longer would be another rig to the twin."""
    plant = TimedPlant()
    bus = flying(plant)
    latest: dict[int | str, float] = {}
    for shape in range(7):
        play(bus, "EXCITE", shape=shape, ticks=20, **{**SIGNAL, "duration": 0})
        plant.after_conversion.clear()
        bus.run(80)
        latest[shape] = max(plant.after_conversion)
        assert len(plant.after_conversion) >= 79
    play(bus, "SET_MODE", mode=1, ticks=5)
    plant.after_conversion.clear()
    bus.run(40)
    latest["open loop"] = max(plant.after_conversion)
    assert max(latest.values()) - min(latest.values()) < 50e-6, latest
    assert max(latest.values()) < 300e-6


@pytest.mark.parametrize(
    ("clock_hz", "clocks", "share"),
    [  # of T_s, as in the table of firmware/README.md; above 1 it does not fly
        (11_059_200, 12, 7.37),
        (22_118_400, 12, 3.68),
        (33_177_600, 12, 2.46),
        (22_118_400, 6, 1.84),
        (11_059_200, 1, 0.78),
        (20_000_000, 1, 0.43),
    ],
)
def test_the_load_of_closed_loop_with_500_states_a_second(clock_hz: int, clocks: int, share: float) -> None:
    """The image on other clocks, by what its cycles would take there: those outside of the main loop's idle turns."""
    bus = flying(slow=clocks > 1)
    turns = bus.board.chip.turns
    bus.run(50)
    busy = TICK_CYCLES - (bus.board.chip.turns - turns) / 50 * IDLE_TURN[clocks > 1]

    assert busy / (clock_hz / clocks * T_S_US * 1e-6) == pytest.approx(share, rel=0.05)


IDLE_TURN = {False: 360.0, True: 239.0}  # cycles of a turn in which nothing is to be done, without its interrupts


def test_it_fits_the_part_and_leaves_stack() -> None:
    bus = flying()
    for name, fields in COMMANDS:
        play(bus, name, ticks=30 if name == "CAPTURE" else 12, **fields)
    play(bus, "SET_MODE", mode=1)
    for shape in (5, 6):  # samples of a capture while a signal makes its divisions
        play(bus, "EXCITE", shape=shape, **{**SIGNAL, "target": 0}, ticks=0)
        play(bus, "CAPTURE", u_from=300, u_to=1700, pre=40, count=240, ticks=40)
    sizes = json.loads(image().read_text(encoding="utf-8"))["sizes"]
    deepest = bus.board.chip.cpu.deepest

    assert sizes["code"] < 32 * 1024 < 62 * 1024
    assert sizes["external_ram"] <= 2048 - 6
    assert sizes["stack_from"] <= 0x80
    assert sizes["stack_from"] + 60 < deepest < 256 - 16


def test_what_the_interrupt_calls_keeps_nothing_at_fixed_addresses(tmp_path: Path) -> None:
    """Else it would change what the main loop is in the middle of: sdcc gives locals and arguments fixed places."""
    calls: dict[str, set[str]] = {}
    static: dict[str, list[str]] = {}
    for source in image_sources():
        out = tmp_path / f"{source.stem}.rel"
        command = [str(shutil.which("sdcc")), *flags("MCS51_FLAGS", "MCS51_CONFIG"), "-c", str(source), "-o", str(out)]
        subprocess.run(command, check=True, cwd=tmp_path)
        text = out.with_suffix(".asm").read_text(encoding="utf-8")
        for name, code in re.findall(r"^_(\w+):\n(.*?)(?=^_\w+:\n|\Z)", text.partition(".area CSEG")[2], re.M | re.S):
            calls[name] = set(re.findall(r"l(?:call|jmp)\t_(\w+)", code))
        data = text.partition(".area DSEG")[2].partition(".area HOME")[0]
        for variable in re.findall(r"^_(\w+?):+\n\t\.ds", data, re.M):
            static.setdefault(source.stem, []).append(variable)
    reached: set[str] = set()
    todo = ["b51_on_time"]
    while todo:
        name = todo.pop()
        todo += calls.get(name, set()) - reached
        reached |= calls.get(name, set())
    fixed = [v for names in static.values() for v in names for function in reached if v.startswith(f"{function}_")]

    assert reached == INTERRUPT_FUNCTIONS  # and no routine of the compiler's
    assert any(v.startswith("b51_scaled_product_") for v in static["arithmetic"])  # the search does find such variables
    assert fixed == []


def test_without_its_data_memory_it_is_the_emulated_board_and_with_a_bit_changed_too() -> None:
    whole = Mcs51Board(Bench(), board_id=51)
    broken = bytearray(bytes(whole.chip.eeprom))
    broken[50] ^= 4
    answers = []
    for eeprom in (None, b"", bytes(broken)):
        bus = ChipHost(Mcs51Board(Bench(), board_id=51, eeprom=eeprom))
        bus.run(20)
        bus.hello()
        bus.request("GET_PARAMETERS")
        identity, parameters = (m for m in bus.messages if m.name in ("IDENTITY", "PARAMETERS"))
        assert identity.int("board_id") == (51 if eeprom is None else 0)
        answers.append(
            ({k: v for k, v in identity.values.items() if k.split("_")[-1] in ("lsb", "offset")}, parameters)
        )

    assert answers[0] == answers[1] == answers[2]


def test_the_emulated_board_in_program_memory_is_that_of_the_emulator() -> None:
    native = NativeFirmware(Bench())
    native.feed(frame("HELLO", id=1, session=1, version_min=1, version_max=1) + frame("GET_PARAMETERS", id=2))
    native.tick()
    expected = [e for e in StreamDecoder().feed(take_output(native)) if isinstance(e, Message)]
    bus = ChipHost(Mcs51Board(Bench(), eeprom=b""))
    bus.run(20)
    bus.hello()
    bus.request("GET_PARAMETERS")

    assert [m for m in bus.messages if m.name == "PARAMETERS"] == [m for m in expected if m.name == "PARAMETERS"]


@pytest.mark.parametrize("baud", [57600, 230400])
@pytest.mark.slow
def test_the_uart_gets_the_divider_of_the_data_sheet(baud: int) -> None:
    board = Mcs51Board(Bench(), baud=baud)
    for _ in range(10):
        board.tick()
    t3con, t3fd = (board.chip.cpu.sfr[address - 0x80] for address in (0x9E, 0x9D))

    made = 2 * CLOCK_HZ / 2 ** ((t3con & 7) - 1) / (t3fd + 64)
    assert made == actual_baud(baud)
    assert abs(made / baud - 1) < 0.005


def test_before_its_start_the_board_has_lost_nothing() -> None:
    """Its RAM is random then."""
    board = Mcs51Board(Bench())

    before = (board.dropped, board.bad_frames, board.next_tick)
    board.tick()

    assert before == (0, 0, 0)
    assert board.dropped == 0
