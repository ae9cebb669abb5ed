"""Campaigns of flights: their plan, their numbers, and a folder that goes on where it was."""

import json
import os
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from vwnav.__main__ import app
from vwnav.bench.flights.campaign import Campaign, FlightScore, Sortie, campaign_of
from vwnav.bench.flights.folder import FLIGHTS, CampaignFolder, fly_campaign
from vwnav.bench.flights.plots import save_plots
from vwnav.bench.flights.score import distance_m
from vwnav.bench.flights.summary import Figure, summarise, worst_first
from vwnav.bench.resampling import interval
from vwnav.errors import RouteError, VwnavError
from vwnav.geometry.geodesy import LocalFrame
from vwnav.guidance.plan_files import load_route
from vwnav.onboard.simulation import ROUTES
from vwnav.sim.config import Manners
from vwnav.sim.named_sites import MAP_EAST_M, MAP_NORTH_M, MAP_SIGMA_M

CAMPAIGN = Campaign(route_ned_m=((60.0, 0.0, -50.0), (0.0, 80.0, -50.0)), sites=2)


def px4(count: int) -> list[Sortie]:
    return [Sortie("px4", number) for number in range(count)]


def flight(
    number: int, error_m: float = 0.3, wrong: tuple[str, ...] = (), manners: Manners = "px4"
) -> FlightScore:
    return FlightScore(
        manners=manners, number=number, site="1", seed=7, wind_m_s=8.0, wind_from_deg=90.0,
        flown_s=60.0, way_m=240.0, wrong=wrong, errors_m=(error_m, 2.0 * error_m), nees=(1.0, 7.0),
        worst_m=3.0 * error_m, cross_m=(0.1, 0.2), touchdown_m=0.5, available=1.0, fixes=90,
        attempts=100, wrong_fixes=0, cpu_s=40.0,
    )  # fmt: skip


def figures(flights: list[FlightScore]) -> dict[str, Figure]:
    return {figure.name: figure for figure in summarise(flights)}


def test_a_flight_is_the_same_however_many_are_flown() -> None:
    assert CAMPAIGN.scenario(Sortie("px4", 3)) == CAMPAIGN.scenario(Sortie("px4", 3))
    winds = {CAMPAIGN.scenario(each).setup.wind_from_deg for each in px4(5)}
    assert len(winds) == 5
    copter = CAMPAIGN.scenario(Sortie("copter", 3)).setup
    assert replace(copter, manners="px4") == CAMPAIGN.scenario(Sortie("px4", 3)).setup
    assert [CAMPAIGN.site_of(k) for k in range(3)] == ["sim:1", "sim:2", "sim:1"]


def test_an_aircraft_is_off_by_what_its_filter_is_told_it_may_be() -> None:
    setups = [CAMPAIGN.scenario(each).setup for each in px4(400)]
    off_deg = np.std([each.mount_off_deg for each in setups], axis=0)
    assert off_deg == pytest.approx([0.2, 0.2, 1.5], rel=0.15)
    assert np.std([each.lens_ratio for each in setups]) == pytest.approx(0.001, rel=0.15)
    assert len({each.map_warp for each in setups}) == 400
    assert setups[0].map_warp.sigma_m == MAP_SIGMA_M


def test_a_route_off_the_map_is_refused_by_its_waypoint() -> None:
    with pytest.raises(RouteError, match="waypoint 2 is 900 m north"):
        campaign_of(np.array([[0.0, 50.0, -50.0], [900.0, 0.0, -50.0]]))


def test_the_long_loop_is_three_kilometres_inside_the_map() -> None:
    route = load_route(ROUTES / "loop_3km.plan").to_ned(LocalFrame(60.4, 22.5, 0.0), 50.0, None)
    campaign = campaign_of(route)
    assert 2900.0 < campaign.way_m < 3100.0
    assert np.all(np.abs(route[:, :2]) < (MAP_NORTH_M / 2.0, MAP_EAST_M / 2.0))


def test_distance_from_a_line_is_to_its_nearest_point() -> None:
    way = np.array([[0.0, 0.0], [10.0, 0.0], [10.0, 10.0]])
    assert distance_m(np.array([5.0, 2.0]), way) == pytest.approx(2.0)
    assert distance_m(np.array([13.0, 14.0]), way) == pytest.approx(5.0)


def test_figures_pool_the_flights_and_tell_how_sure_they_are() -> None:
    found = figures([flight(0, 0.2), flight(1, 0.4)])
    mean = found["error, mean"]
    assert mean.value == pytest.approx(0.45)
    assert (mean.low, mean.high) == pytest.approx((0.3, 0.6))
    assert found["inside the 95 % ellipse"].value == 50.0
    assert found["error, worst"].value == pytest.approx(1.2)
    assert figures([flight(0)])["error, mean"].low is None


def test_the_interval_shrinks_with_the_flights() -> None:
    rng = np.random.default_rng(3)

    def width(count: int) -> float:
        bounds = interval(lambda draw: float(np.mean(draw)), rng.normal(0.0, 1.0, count).tolist())
        assert bounds is not None
        return bounds[1] - bounds[0]

    assert width(400) < 0.4 * width(25)


def test_a_flight_with_something_wrong_comes_before_a_larger_error() -> None:
    flights = [flight(0, 0.9), flight(1, 0.1, ("home moved",)), flight(2, 0.5)]
    assert [each.number for each in worst_first(flights)] == [1, 0, 2]


@dataclass
class Flown:
    """Numbers in the order in which they are flown, without flying."""

    numbers: list[int] = field(default_factory=list)

    def __call__(self, _: Campaign, sortie: Sortie, recording: Path) -> FlightScore:
        self.numbers.append(sortie.number)
        recording.write_text("recorded")
        return flight(sortie.number, 0.1 * (sortie.number + 1), manners=sortie.manners)


@pytest.fixture
def flown() -> Flown:
    return Flown()


def quiet(what: str, done: int, total: int) -> None:
    pass


def test_a_killed_run_goes_on_and_loses_half_a_line(flown: Flown, tmp_path: Path) -> None:
    fly_campaign(CAMPAIGN, px4(2), 1, CampaignFolder(tmp_path, CAMPAIGN), flown, quiet)
    with (tmp_path / FLIGHTS).open("a") as file:
        file.write('{"number": 2, "si')
    flights = fly_campaign(CAMPAIGN, px4(4), 1, CampaignFolder(tmp_path, CAMPAIGN), flown, quiet)
    assert flown.numbers == [0, 1, 2, 3]
    assert flights == [replace(flight(k, 0.1 * (k + 1))) for k in range(4)]
    lines = (tmp_path / FLIGHTS).read_text().splitlines()
    assert [json.loads(line)["number"] for line in lines] == [0, 1, 2, 3]


def test_a_folder_goes_on_in_the_other_manners(flown: Flown, tmp_path: Path) -> None:
    fly_campaign(CAMPAIGN, px4(2), 1, CampaignFolder(tmp_path, CAMPAIGN), flown, quiet)
    both = [Sortie("px4", 1), Sortie("copter", 1)]
    found = fly_campaign(CAMPAIGN, both, 1, CampaignFolder(tmp_path, CAMPAIGN), flown, quiet)
    assert flown.numbers == [0, 1, 1]
    assert [each.sortie for each in found] == both


def test_only_the_worst_keep_their_recordings(flown: Flown, tmp_path: Path) -> None:
    fly_campaign(CAMPAIGN, px4(5), 1, CampaignFolder(tmp_path, CAMPAIGN), flown, quiet)
    kept = sorted(path.name for path in (tmp_path / "worst").iterdir())
    assert kept == [f"px4-000{k}.mcap" for k in (2, 3, 4)]


def test_a_folder_of_another_campaign_is_refused(tmp_path: Path) -> None:
    CampaignFolder(tmp_path, CAMPAIGN)
    with pytest.raises(VwnavError, match="another campaign \\(wind_m_s differ"):
        CampaignFolder(tmp_path, replace(CAMPAIGN, wind_m_s=3.0))


@pytest.mark.parametrize("part", [".", "worst"])
def test_a_folder_that_may_not_be_written_is_said_before_a_flight(part, tmp_path, monkeypatch):
    CampaignFolder(tmp_path, CAMPAIGN)
    monkeypatch.setattr(os, "access", lambda path, _: path != tmp_path / part)
    with pytest.raises(VwnavError, match="it may not be written"):
        CampaignFolder(tmp_path, CAMPAIGN)


def test_a_line_of_another_version_is_said(tmp_path: Path) -> None:
    CampaignFolder(tmp_path, CAMPAIGN)
    old = {name: value for name, value in asdict(flight(0)).items() if name != "cross_m"}
    (tmp_path / FLIGHTS).write_text(json.dumps(old) + "\n")
    with pytest.raises(VwnavError, match="lacks 'cross_m'"):
        CampaignFolder(tmp_path, CAMPAIGN)
    (tmp_path / FLIGHTS).write_text("{]\n")
    with pytest.raises(VwnavError, match="is damaged"):
        CampaignFolder(tmp_path, CAMPAIGN)


def test_bad_input_leaves_no_folder(tmp_path: Path) -> None:
    (tmp_path / "far.txt").write_text("1,900,0,50\n")
    for option, value in (
        ("--route", str(tmp_path / "none.plan")),
        ("--route", str(tmp_path / "far.txt")),
        ("--manners", "px4,plane"),
    ):
        words = ["bench", "flights", option, value, "-o", str(tmp_path / "out")]
        done = CliRunner().invoke(app, words)
        assert isinstance(done.exception, VwnavError)
        assert not (tmp_path / "out").exists()


def test_the_plots_are_drawn(tmp_path: Path) -> None:
    pytest.importorskip("matplotlib")
    paths = save_plots(tmp_path, [flight(0), flight(1, 0.5, ("home moved",), "copter")])
    assert all(path.stat().st_size > 5000 for path in paths)


@pytest.mark.long
def test_a_flight_is_flown_scored_and_checked(tmp_path: Path) -> None:
    words = ["bench", "flights", "--route", "short.plan", "--runs", "1", "--sites", "1", "--json"]
    done = CliRunner().invoke(app, [*words, "-o", str(tmp_path)])
    assert done.exit_code == 0, done.output
    found = json.loads(done.stdout)
    values = {each["name"]: each["value"] for each in found["figures"]["px4"]}
    assert not found["wrong"]
    assert values["error, 95 %"] < 1.5
    assert values["available"] > 95.0
    checked = CliRunner().invoke(
        app, ["replay", str(tmp_path / "worst" / "px4-0000.mcap"), "--check"]
    )
    assert checked.exit_code == 0, checked.output
