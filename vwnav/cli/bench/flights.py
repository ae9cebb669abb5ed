"""`vwnav bench flights`: many lockstep flights of a route, in numbers with intervals."""

import json
import time
from dataclasses import asdict
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from vwnav.cli.manners import manners_of
from vwnav.cli.numbers import finite
from vwnav.errors import VwnavError
from vwnav.files.whole import write_whole

if TYPE_CHECKING:
    from vwnav.bench.flights.campaign import Campaign, FlightScore, Sortie
    from vwnav.bench.flights.summary import Figure
    from vwnav.bench.flights.world import Place
    from vwnav.sim.config import Manners


def flights(
    output: Annotated[
        Path, typer.Option("-o", "--output", help="Folder; one that holds some flights goes on.")
    ],
    runs: Annotated[
        int, typer.Option("--runs", min=1, help="Flights in each manner, those there included.")
    ] = 8,
    route: Annotated[
        Path | None,
        typer.Option(help="Route about home, or first_flight.plan (of `make fly`), loop_3km.plan."),
    ] = None,
    wind_m_s: Annotated[
        float, typer.Option(min=0.0, max=15.0, callback=finite, help="Mean wind, gusty.")
    ] = 8.0,
    sites: Annotated[int, typer.Option(min=1, max=999, help="Generated sites in turn.")] = 4,
    manners: Annotated[
        str,
        typer.Option(
            help="The simulated vehicle's: px4, px4-1.16, copter, or some of them with commas."
        ),
    ] = "px4",
    seed: Annotated[int, typer.Option(help="Flight k of a seed is always the same.")] = 0,
    jobs: Annotated[int, typer.Option(min=1, help="Processes.")] = 1,
    as_json: Annotated[bool, typer.Option("--json", help="One JSON object on stdout.")] = False,
) -> None:
    """Fly a route again and again in simulated time: the whole program, in wind, over other sites.

    Every flight is held against the rules of every flight. Each leaves a line in flights.jsonl, so
    a run that was killed goes on where it was; the worst ones keep their recordings.

    Example: vwnav bench flights --runs 100 --manners px4,copter --jobs 8 -o flights
    """
    from vwnav.bench.figures import pyplot
    from vwnav.bench.flights.campaign import Sortie
    from vwnav.bench.flights.folder import CampaignFolder, fly_campaign
    from vwnav.bench.flights.plots import save_plots
    from vwnav.bench.flights.summary import summarise, worst_first
    from vwnav.screen import progress_bar, say

    pyplot()  # what is missing is said before anything is flown
    flying_as = tuple(dict.fromkeys(manners_of(each) for each in manners.split(",")))
    campaign = _campaign(route, wind_m_s, sites, seed)
    wanted = [Sortie(each, number) for number in range(runs) for each in flying_as]
    folder = CampaignFolder(output, campaign)
    for site in sorted({campaign.site_of(sortie.number) for sortie in folder.lacks(wanted)}):
        _place(site)  # its map is drawn once, by this process
    with progress_bar() as progress:
        flown = fly_campaign(campaign, wanted, jobs, folder, fly_one, progress)
    figures = {each: summarise([f for f in flown if f.manners == each]) for each in flying_as}
    save_plots(output, flown)
    values = {"campaign": campaign.as_json(), "flights": runs} | {
        "figures": {name: [asdict(each) for each in found] for name, found in figures.items()},
        "wrong": {str(each.sortie): each.wrong for each in flown if each.wrong},
        "worst": [str(each.sortie) for each in worst_first(flown)[:3]],
    }
    write_whole(output / "summary.json", json.dumps(values, indent=1) + "\n")
    if as_json:
        print(json.dumps(values))
    else:
        _print(campaign, flown, figures)
    for each in flown:
        for line in each.wrong:
            say(f"flight {each.sortie}: {line}")


def fly_one(campaign: "Campaign", sortie: "Sortie", recording: Path) -> "FlightScore":
    """Fly and score one, in whatever process; a recording of a run that was killed goes first."""
    import cv2

    from vwnav.bench.flights.fly import fly
    from vwnav.bench.flights.score import score

    cv2.setNumThreads(1)
    recording.unlink(missing_ok=True)
    site, begin_s = campaign.site_of(sortie.number), time.process_time()
    flown = fly(campaign.scenario(sortie), _place(site), recording)
    return score(sortie, site, campaign.way_ne_m, flown, time.process_time() - begin_s)


@cache
def _place(site: str) -> "Place":
    """One of each site in a process."""
    from vwnav.assemble import choose_features
    from vwnav.bench.flights.world import Place
    from vwnav.onboard.simulation import map_pack_of
    from vwnav.screen import say
    from vwnav.sim.named_sites import parse_site
    from vwnav.sim.renderer import default_camera
    from vwnav.vision.config import FeaturesConfig

    primary, fallback = choose_features(FeaturesConfig(), say)
    if fallback is None:
        raise VwnavError("learned features are not available: flights of them cannot be measured")
    pack = map_pack_of(site, [primary, fallback])
    return Place(parse_site(site), pack, default_camera(), primary, fallback)


def _campaign(route: Path | None, wind_m_s: float, sites: int, seed: int) -> "Campaign":
    from vwnav.bench.flights.campaign import campaign_of
    from vwnav.geometry.geodesy import LocalFrame
    from vwnav.guidance.plan_files import DEFAULT_HEIGHT_M, load_route
    from vwnav.onboard.simulation import DEFAULT_ROUTE, ROUTES
    from vwnav.sim.site import Site

    home = Site(1)
    frame = LocalFrame(home.home_lat_deg, home.home_lon_deg, 0.0)
    path = route or DEFAULT_ROUTE
    embedded = ROUTES / path.name
    path = path if path.exists() or not embedded.exists() else embedded
    loaded = load_route(path)
    ground_m = loaded.ground_amsl_m((home.home_lat_deg, home.home_lon_deg), None)
    route_ned_m = loaded.to_ned(frame, DEFAULT_HEIGHT_M, ground_m)
    return campaign_of(route_ned_m, wind_m_s=wind_m_s, sites=sites, seed=seed)


def _print(
    campaign: "Campaign", flown: "list[FlightScore]", figures: "dict[Manners, list[Figure]]"
) -> None:
    from vwnav.screen import print_table

    for manners, found in figures.items():
        flights = [each for each in flown if each.manners == manners]
        rows = []
        for each in found:
            interval = "" if each.low is None else f"  [{each.low:.3g}, {each.high:.3g}]"
            rows.append((each.name, f"{each.value:.4g} {each.unit}".strip() + interval))
        wrong = sum(bool(each.wrong) for each in flights)
        rows.append(("flights with something wrong", f"{wrong} of {len(flights)}"))
        hours = sum(each.cpu_s for each in flights) / len(flights) / 3600.0
        rows.append(
            ("100 and 600 flights, one core", f"{100 * hours:.1f} h and {600 * hours:.0f} h")
        )
        print_table(
            f"{len(flights)} flights in the manners of {manners}, {campaign.way_m:.0f} m, "
            f"wind {campaign.wind_m_s:g} m/s, {campaign.sites} sites; 95 % intervals",
            rows,
        )
