"""The plant cards of the gateway: read at its start, published every 5 s, and kept in files.

    LOGS/plants/<board>.toml    the card that was stated over the bus, with sender and time; LOGS is [log] directory

Rule 1: the newest statement counts: the date of the configured file (`plant` of [[board]]), or the time of a command.
        `--plant` of the command line states a card at the start.
Rule 2: a card is written by the main thread within a second, and at the end: the serial thread waits for no disk.
Rule 3: a kept card that cannot be read or written is an event, and the gateway runs on.
"""

from __future__ import annotations

import logging
import math
import time
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Annotated

from gateway.config import BoardConfig, GatewayConfig
from gateway.link.card_keeper import STATED
from gateway.link.driver import BoardDriver
from protocol.bus import board51_pb2 as pb
from protocol.bus.plant_card import EMULATED, card_plant, plant_message
from protocol.campaign import PlantFile, load_stated_plant
from protocol.campaign_text import plant_text
from protocol.checked import Number, checked, key
from protocol.errors import Board51Error, ConfigError, DataError, UsageError
from protocol.files import parse_toml, read_small, replace_text
from protocol.plant import Objection, Plant, in_words, objections

EVERY_S = 5.0
CONFIGURATION = "configuration"  # who stated it
_NOT_STORED = "plant-not-kept"  # the event
_LAST_S = 1e10  # a message has room for nanoseconds until the year 2554
_logger = logging.getLogger("gateway")


@dataclass(frozen=True, kw_only=True)
class _Stated:
    who: str
    at_s: Annotated[Number, key("Unix time", 0.0, _LAST_S)]
    board: str = ""


@dataclass(frozen=True, kw_only=True)
class _StoredFile(PlantFile):
    stated: _Stated


def configured_card(board: BoardConfig) -> pb.PlantCard:
    """Return the card that the configuration states; without a plant if it states none.

    Raises:
        ConfigError: the file cannot be read, or its [plant] is not usable.
    """
    if not board.plant:
        return pb.PlantCard()
    file = Path(board.plant)
    try:
        plant = load_stated_plant(file)
        written_ns = (file / "campaign.toml" if file.is_dir() else file).stat().st_mtime_ns
    except UsageError as error:
        raise ConfigError(f"plant of the board {board.name}: {error.problem}", remedy=error.remedy) from None
    return pb.PlantCard(plant=plant_message(plant), who=CONFIGURATION, stated_ns=written_ns)


def state_now(config: GatewayConfig, board: str, file: Path, who: str) -> tuple[Objection, ...]:
    """Keep the plant of a file as if it was stated now, before the gateway runs; return what is unusual about it.

    Raises:
        UsageError: the file cannot be read, its [plant] is not usable, or the card cannot be written.
    """
    plant, path = load_stated_plant(file), folder_of(config) / f"{board}.toml"
    try:
        _write(path, pb.PlantCard(who=who, stated_ns=time.time_ns()), plant)
    except OSError as error:
        raise UsageError(
            f"The plant card cannot be written to {path}: {error.strerror}", remedy="Give another --log-dir"
        ) from None
    return objections(asdict(plant))


def folder_of(config: GatewayConfig) -> Path:
    """Return the folder of the kept cards."""
    return Path(config.log.directory) / "plants"


class BoardCard:
    """The card of one board between driver, bus and disk; the folder is made when one is stated.

    Raises:
        ConfigError: of `configured_card`.
    """

    def __init__(self, driver: BoardDriver, folder: Path) -> None:
        self._driver, self._keeper = driver, driver.handler.plant_card
        self._file = folder / f"{driver.config.name}.toml"
        self._sent_s = -math.inf
        self._unreadable = ""
        configured, stored = configured_card(driver.config), self._read()
        self._keeper.card = max(configured, stored, key=lambda card: card.stated_ns)
        self._replaced = card_plant(stored) if self._keeper.card is configured else None
        self._stored = self._keeper.card
        self._failed = False

    def poll(self, now_s: float) -> None:
        """Publish the card if that is due, and write it if it has changed; `now_s`: monotonic."""
        if self._sent_s == -math.inf:
            self._report()
        if now_s - self._sent_s >= EVERY_S:
            self._sent_s = now_s
            self._keeper.send(self._driver.report.host_ns())
        self.keep()

    def keep(self) -> None:
        """Write the card if it was stated since it was last written."""
        card = self._keeper.card
        if card == self._stored or card.who in (EMULATED, CONFIGURATION) or (plant := card_plant(card)) is None:
            return
        try:
            _write(self._file, card, plant)
        except OSError as error:
            if not self._failed:
                text = f"The plant card cannot be written to {self._file}: {error.strerror}. A restart forgets it."
                self._warn(text)
            self._failed = True
            return
        self._stored, self._failed = card, False

    def _report(self) -> None:
        """Say at the start what is unusual, and what the newest statement has changed."""
        if self._unreadable:
            self._warn(self._unreadable)
        plant, file = card_plant(self._keeper.card), self._driver.config.plant
        if plant is None or self._keeper.card.who != CONFIGURATION:
            return
        for objection in objections(asdict(plant)):
            self._warn(f"{file}: {objection.key}: {objection.text}", name="plant-unusual")
        if self._replaced is not None and plant != self._replaced:
            text = f"{CONFIGURATION} ({file}): {in_words(plant)}; before: {in_words(self._replaced)}"
            self._driver.report.publish(STATED, "info", text)

    def _read(self) -> pb.PlantCard:
        if not self._file.exists():
            return pb.PlantCard()
        remedy = "State the plant again"
        try:
            table = parse_toml(read_small(self._file, remedy=remedy), where=str(self._file), remedy=remedy)
            stored: _StoredFile = checked(_StoredFile, table, where=str(self._file), error=DataError, remedy=remedy)
        except Board51Error as error:
            self._unreadable = f"The kept plant card is not used: {error}"
            return pb.PlantCard()
        stated = stored.stated
        return pb.PlantCard(
            plant=plant_message(stored.plant), who=stated.who, stated_ns=round(stated.at_s * 1e9), board=stated.board
        )

    def _warn(self, text: str, *, name: str = _NOT_STORED) -> None:
        _logger.warning("%s: %s", self._driver.config.name, text)
        self._driver.report.publish(name, "warning", text)


def _write(file: Path, card: pb.PlantCard, plant: Plant) -> None:
    """Write a kept card.  Raises OSError."""
    comments = ["The plant card of a rig, kept by `board51 gateway`.  --plant takes this file, too."]
    stated = {"who": card.who, "at_s": card.stated_ns * 1e-9, "board": card.board}
    file.parent.mkdir(parents=True, exist_ok=True)
    replace_text(file, plant_text(plant, stated, comments=comments))
