"""A folder of flights, a line of JSON each, and how those that it lacks are flown."""

import json
import multiprocessing
import os
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import asdict, fields
from pathlib import Path
from typing import Any

from vwnav.bench.flights.campaign import Campaign, FlightScore, Sortie
from vwnav.bench.flights.summary import worst_first
from vwnav.errors import VwnavError
from vwnav.machine.signals import raise_signals
from vwnav.recording.run_folder import write_json

CAMPAIGN, FLIGHTS, RECORDINGS = "campaign.json", "flights.jsonl", "worst"
_WORST_KEPT = 3

FlyOne = Callable[[Campaign, Sortie, Path], FlightScore]


class CampaignFolder:
    """A folder of flights: what they are of, a line of JSON each, the recordings of the worst.

    A killed run leaves whole lines and perhaps half of one, which is cut off.

    Raises:
        VwnavError: it cannot be written to, or holds flights of another campaign.
    """

    def __init__(self, folder: Path, campaign: Campaign) -> None:
        self.folder = folder
        self._lines = folder / FLIGHTS
        try:
            folder.mkdir(parents=True, exist_ok=True)
            self._claim(campaign)
            (folder / RECORDINGS).mkdir(exist_ok=True)
            self.flights = self._read()
        except OSError as error:
            raise VwnavError(f"cannot use the folder {folder}: {error.strerror}") from error
        if not (os.access(folder, os.W_OK) and os.access(folder / RECORDINGS, os.W_OK)):
            raise VwnavError(f"cannot use the folder {folder}: it may not be written")

    def _claim(self, campaign: Campaign) -> None:
        path, wanted = self.folder / CAMPAIGN, campaign.as_json()
        if not path.exists():
            write_json(path, wanted)
            return
        try:
            found = json.loads(path.read_text())
        except ValueError as error:
            raise VwnavError(f"{path} is damaged: {error}") from error
        if found != wanted:
            unlike = [name for name in wanted if found.get(name) != wanted[name]]
            raise VwnavError(
                f"{self.folder} holds flights of another campaign ({', '.join(unlike)} differ): "
                "give another folder with -o"
            )

    def _read(self) -> list[FlightScore]:
        if not self._lines.exists():
            return []
        text = self._lines.read_text()
        whole = text[: text.rfind("\n") + 1]
        if whole != text:
            self._lines.write_text(whole)
        return [_score_of(line) for line in whole.splitlines()]

    def lacks(self, wanted: Iterable[Sortie]) -> list[Sortie]:
        """Those that are not in it."""
        done = {each.sortie for each in self.flights}
        return [sortie for sortie in wanted if sortie not in done]

    def recording(self, sortie: Sortie) -> Path:
        """Of a flight that has ended."""
        return self.folder / RECORDINGS / f"{sortie.manners}-{sortie.number:04d}.mcap"

    def partial(self, sortie: Sortie) -> Path:
        """Where a flight records until it has ended."""
        return self.recording(sortie).with_suffix(".mcap.part")

    def add(self, flown: FlightScore) -> None:
        """Append a flight; of all so far only the worst keep their recordings."""
        with self._lines.open("a") as file:
            file.write(json.dumps(asdict(flown)) + "\n")
        self.flights.append(flown)
        self.partial(flown.sortie).replace(self.recording(flown.sortie))
        for each in worst_first(self.flights)[_WORST_KEPT:]:
            self.recording(each.sortie).unlink(missing_ok=True)


def fly_campaign(
    campaign: Campaign,
    wanted: Sequence[Sortie],
    jobs: int,
    folder: CampaignFolder,
    fly_one: FlyOne,
    progress: Callable[[str, int, int], None],
) -> list[FlightScore]:
    """Fly what the folder lacks of the flights that are wanted; all of these, in their order.

    `fly_one` is a function of a module, called in whatever process.
    """
    missing = folder.lacks(wanted)
    progress("flights", len(wanted) - len(missing), len(wanted))
    for i, flown in enumerate(_fly_all(campaign, missing, jobs, folder, fly_one), 1):
        folder.add(flown)
        progress("flights", len(wanted) - len(missing) + i, len(wanted))
    flown_of = {each.sortie: each for each in folder.flights}
    return [flown_of[sortie] for sortie in wanted]


def _fly_all(
    campaign: Campaign, sorties: list[Sortie], jobs: int, folder: CampaignFolder, fly_one: FlyOne
) -> Iterator[FlightScore]:
    """As they end."""
    if jobs == 1:
        yield from (fly_one(campaign, sortie, folder.partial(sortie)) for sortie in sorties)
        return
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(jobs, context, raise_signals) as pool:
        flying = [pool.submit(fly_one, campaign, s, folder.partial(s)) for s in sorties]
        try:
            for each in as_completed(flying):
                yield each.result()
        finally:
            pool.shutdown(wait=False, cancel_futures=True)


def _score_of(line: str) -> FlightScore:
    try:
        values = json.loads(line)
        known = {field.name: values[field.name] for field in fields(FlightScore)}
    except KeyError as error:
        raise VwnavError(f"{FLIGHTS} lacks {error}: flown by another version") from error
    except (ValueError, TypeError) as error:
        raise VwnavError(f"{FLIGHTS} is damaged: {error}") from error
    whole: dict[str, Any] = {n: tuple(v) if isinstance(v, list) else v for n, v in known.items()}
    return FlightScore(**whole)
