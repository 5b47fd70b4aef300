"""The resources that the firmware takes of an ATmega328P: cycles of a tick, stack, RAM and flash, each with its limit.

The cycles of a tick are those in which the chip is awake within T_s: the law, converters and bus waited for, interrupts
for every byte, commands, frames.  The table of firmware/README.md has what `-s` prints here.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

import pytest

from firmware.sim.avr.board import CYCLES_PER_TICK, AvrBoard
from protocol.wire.messages import EventCode
from tests.harness.firmware.avr_bench import AvrHost, skip_without_avr
from tests.harness.gateway.board_host import Bench

MAX_CYCLES = 0.9 * CYCLES_PER_TICK
MIN_STACK_FREE = 96  # bytes that nothing has ever used
MAX_FLASH = 20 * 1024  # of 32 kB, of which a boot loader has 0.5
RAM = 2048


@pytest.fixture(scope="module")
def played() -> tuple[AvrHost, dict[str, int]]:
    """A chip that has done everything, and the most cycles of a tick of each thing."""
    skip_without_avr()
    host = AvrHost(AvrBoard(Bench(i_a=0.6365)))
    host.run(5)
    host.hello()
    host.run(20)
    host.request("SET_HOST_LOSS", policy=0, timeout=60000)
    worst: dict[str, int] = {}

    def measure(what: str, action: Callable[[], object], ticks: int = 40) -> None:
        start = len(host.cycles)
        action()
        host.run(ticks)
        worst[what] = max(host.cycles[start:])

    measure("idle, STATE at 500 Hz", lambda: None)
    measure("SET_MODE, closed loop (LQI)", lambda: host.request("SET_MODE", mode=2))
    shapes = ("step", "rectangle", "sawtooth", "PRBS", "multisine", "chirp")
    for shape, name in enumerate(shapes, start=1):
        signal = {"target": 1, "amplitude": 200, "offset": 2034, "period": 300, "period_end": 7, "seed": 0x7FFF}
        measure(f"EXCITE {name}, and its ticks", partial(host.request, "EXCITE", shape=shape, duration=30, **signal))
    slow = {f"k{n}_{part}": 32767 if part == "mantissa" else 30 for n in range(1, 5) for part in ("mantissa", "shift")}
    measure(
        "closed loop (PID), shifts of 30",
        lambda: host.request("SET_GAINS", law=1, i_0=1304, x_0=2034, u_0=1756, **slow),
    )
    measure("GET_PARAMETERS", lambda: host.request("GET_PARAMETERS"))
    measure("HELLO", host.hello)
    measure("a PING in each frame that the line holds", partial(pings, host, 60))
    measure("CAPTURE, sample by sample", capture(host))
    measure("READ_CAPTURE", lambda: host.request("READ_CAPTURE", index=0))
    return host, worst


def capture(host: AvrHost) -> Callable[[], object]:
    """Return an action that starts a capture from open loop, with the line full of commands."""

    def play() -> None:
        host.request("SET_MODE", mode=1)
        assert host.request("CAPTURE", u_from=300, u_to=1700, pre=50, count=200).name == "ACK"
        pings(host, 30)

    return play


def pings(host: AvrHost, ticks: int) -> None:
    """A command in each tick."""
    for _ in range(ticks):
        host.send("PING")
        host.run()


def test_no_tick_takes_more_than_its_share(played: tuple[AvrHost, dict[str, int]]) -> None:
    host, worst = played
    for what, cycles in worst.items():
        print(f"| {what} | {cycles} | {100 * cycles / CYCLES_PER_TICK:.0f} % |")

    assert max(worst.values()) < MAX_CYCLES
    assert EventCode.OVERRUN not in host.codes()
    assert EventCode.CAPTURE_DONE in host.codes()
    assert host.bad_frames == 0
    assert min(worst.values()) > CYCLES_PER_TICK / 10  # it is counted at all


def test_ram_is_left_over_the_stack(played: tuple[AvrHost, dict[str, int]]) -> None:
    host, _ = played
    variables = host.board.image.ram("_end") - 0x100
    free = host.board.stack_free
    print(f"variables {variables}, stack at its deepest {RAM - variables - free}, free {free} of {RAM} bytes")

    assert free >= MIN_STACK_FREE
    assert RAM - variables - free > 50


def test_the_program_fits_beside_a_boot_loader(played: tuple[AvrHost, dict[str, int]]) -> None:
    size = len(played[0].board.image.code)
    print(f"flash {size} bytes")

    assert 8 * 1024 < size < MAX_FLASH


def test_readings_and_input_keep_their_times(played: tuple[AvrHost, dict[str, int]]) -> None:
    """A tick begins when the timer says so: nothing that the main loop does delays it by a quarter of T_s."""
    host, _ = played
    begins: list[int] = []

    class Watched(Bench):
        def sense(self) -> tuple[float, float]:
            begins.append(host.board.cycle)
            return super().sense()

    host.board.connect(Watched())
    pings(host, 100)

    # Of the current, against the first tick; the position follows it.
    half = CYCLES_PER_TICK // 2
    phases = [(cycle - begins[0] + half) % CYCLES_PER_TICK - half for cycle in begins[::2]]
    print(f"ticks begin within {(max(phases) - min(phases)) / 16:.0f} us")
    assert len(begins) == 200
    assert max(phases) - min(phases) < CYCLES_PER_TICK / 4
