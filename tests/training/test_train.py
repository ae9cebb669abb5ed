from dataclasses import replace
from unittest.mock import Mock

import numpy as np
import pytest
import torch

from export.export_onnx import slim_checkpoint
from models.network import FeatureNetwork
from training import train, validate
from training.config import PRESETS, config_from_saved, load_checkpoint, parse
from training.journal import Journal

SHORT = replace(
    PRESETS["smoke"],
    minutes=0.0,
    max_steps=8,
    batch_pairs=2,
    log_every_steps=2,
    loader_processes=0,
    validation_pairs=1,
    bfloat16=False,  # so that two runs agree to the last bit
    threads=1,
)


@pytest.fixture(autouse=True)
def two_threads_again():
    threads = torch.get_num_threads()
    yield
    torch.set_num_threads(threads)


def test_the_learning_rate_warms_up_and_ends_cooled():
    rates = [train.learning_rate(p, PRESETS["default"]) for p in np.linspace(0, 1, 101)]
    assert rates[0] < rates[1] == pytest.approx(1e-3, rel=0.01)
    assert rates[-1] == pytest.approx(1e-5)
    assert (np.diff(rates[1:]) <= 0).all()


def test_the_command_line_changes_the_preset():
    config, resume = parse("", ["--preset", "nano", "--minutes", "3", "--seed", "9"])
    assert (config.network.name, config.minutes, config.seed, resume) == ("nano", 3.0, 9, "")


def test_any_choice_can_be_set():
    arguments = ["--set", "samples.warp.scale_max=1.2", "--set", "samples.shares.site=0.5"]
    config, _ = parse("", [*arguments, "--set", "bfloat16=false", "--set", "matches=64"])
    assert config.samples.warp.scale_max == 1.2
    assert config.samples.shares["site"] == 0.5
    assert (config.bfloat16, config.matches) == (False, 64)


@pytest.mark.parametrize("change", ["speed=9", "matches=many", "samples.shares.sites=1"])
def test_a_choice_that_is_none_is_refused(change, capsys):
    with pytest.raises(SystemExit):
        parse("", ["--set", change])
    assert f"--set {change}" in capsys.readouterr().err


def test_a_new_run_can_start_from_the_weights_of_another(drawn_scenes, tmp_path):
    first = train.main(
        replace(SHORT, out=str(tmp_path / "a"), max_steps=1), scenes=(drawn_scenes, [])
    )
    wider = replace(SHORT.network, keypoint_channels=16)
    network = FeatureNetwork(wider)
    train.start_from(network, str(first))
    average = load_checkpoint(first)["average"]
    own = network.state_dict()
    torch.testing.assert_close(own["descriptors.weight"], average["module.descriptors.weight"])
    assert own["peak_logits.weight"].shape[1] == 16


@pytest.mark.parametrize("option", ["--init", "--resume"])
@pytest.mark.parametrize(("content", "said"), [(None, "no checkpoint"), (b"x" * 99, "not a whole")])
def test_a_checkpoint_that_is_none_is_one_line(option, content, said, drawn_scenes, tmp_path):
    path = tmp_path / "last.pt"
    if content is not None:
        path.write_bytes(content)
    with pytest.raises(SystemExit, match=said):
        train.main(*parse("", [option, str(path), "--out", str(tmp_path)]), (drawn_scenes, []))


def test_released_weights_are_no_interrupted_run(drawn_scenes, tmp_path):
    path = train.main(replace(SHORT, out=str(tmp_path), max_steps=1), scenes=(drawn_scenes, []))
    released = tmp_path / "released.ckpt"
    slim_checkpoint(path, released)
    arguments = ["--resume", str(released), "--out", str(tmp_path)]
    with pytest.raises(SystemExit, match="--init"):
        train.main(*parse("", arguments), scenes=(drawn_scenes, []))


def test_a_checkpoint_rebuilds_its_configuration(drawn_scenes, tmp_path):
    config = replace(SHORT, out=str(tmp_path), max_steps=1)
    path = train.main(config, scenes=(drawn_scenes, []))
    assert config_from_saved(load_checkpoint(path)["config"]) == config


def test_an_interrupted_run_resumes_to_the_same_weights(drawn_scenes, tmp_path, monkeypatch):
    whole = train.main(replace(SHORT, out=str(tmp_path / "whole")), scenes=(drawn_scenes, []))
    broken = replace(SHORT, out=str(tmp_path / "broken"), save_every_minutes=0.0)

    def stop(*_):
        raise KeyboardInterrupt

    tell = Journal.tell
    monkeypatch.setattr(Journal, "tell", lambda s, n, *a: stop() if n == 6 else tell(s, n, *a))
    with pytest.raises(KeyboardInterrupt):
        train.main(broken, scenes=(drawn_scenes, []))
    monkeypatch.undo()
    resumed = train.main(broken, str(tmp_path / "broken/last.pt"), scenes=(drawn_scenes, []))
    states = [load_checkpoint(p)["network"] for p in (whole, resumed)]
    for name, value in states[0].items():
        torch.testing.assert_close(states[1][name], value, atol=1e-6, rtol=1e-5)


def test_a_student_becomes_like_the_network_it_is_distilled_from(drawn_scenes, tmp_path):
    teacher = train.main(
        replace(SHORT, out=str(tmp_path / "teacher"), max_steps=1), scenes=(drawn_scenes, [])
    )
    config = replace(SHORT, max_steps=40, log_every_steps=5, seed=2, out=str(tmp_path))
    train.main(
        replace(config, distil_from=str(teacher), distil_weight=20.0), scenes=(drawn_scenes, [])
    )
    log = np.genfromtxt(tmp_path / "log.csv", delimiter=",", names=True, usecols=range(12))
    unlike = log["unlike"]
    unlike = unlike[~np.isnan(unlike)]
    assert 0.0 < unlike[-1] < 0.7 * unlike[0]


def test_without_images_training_says_what_to_do_and_leaves_nothing(tmp_path):
    with pytest.raises(SystemExit, match="no training pictures"):
        train.main(replace(SHORT, out=str(tmp_path / "run")), scenes=([], []))
    assert not (tmp_path / "run").exists()


def test_data_that_cannot_be_read_and_a_run_that_cannot_be_kept_are_one_line(
    drawn_scenes, tmp_path
):
    (tmp_path / "train/single/a").mkdir(parents=True)
    with pytest.raises(SystemExit, match="no training pictures"):  # no series either
        train.main(replace(SHORT, data=str(tmp_path), sites="no", out=str(tmp_path / "run")))
    (tmp_path / "train/single/a/0.png").write_bytes(b"no picture")
    with pytest.raises(SystemExit, match=r"no readable picture at .*0\.png"):
        train.main(replace(SHORT, data=str(tmp_path), sites="no", out=str(tmp_path / "run")))
    (tmp_path / "file").write_text("")
    with pytest.raises(SystemExit, match="file"):
        train.main(replace(SHORT, out=str(tmp_path / "file")), scenes=(drawn_scenes, []))


@pytest.mark.parametrize(
    ("wrong", "said"),
    [
        (["--minutes", "nan"], "minutes = nan"),
        (["--minutes", "-1"], "minutes = -1"),
        (["--minutes", "0"], "would never end"),
        (["--set", "learning_rate=nan"], "learning_rate = nan"),
        (["--set", "samples.zoom_min=inf"], "samples.zoom_min = inf"),
        (["--set", "samples.size_px=100"], "a multiple of 32"),
        (["--set", "batch_pairs=0"], "batch_pairs = 0"),
        (["--set", "log_every_steps=0"], "log_every_steps = 0"),
    ],
)
def test_what_no_run_can_be_made_with_is_one_line_before_images_are_read(
    wrong, said, tmp_path, monkeypatch
):
    monkeypatch.setattr(train, "load_scenes", lambda *_: pytest.fail("it read images"))
    with pytest.raises(SystemExit, match=said) as stop:
        train.run([*wrong, "--out", str(tmp_path / "run")])
    assert "\n" not in str(stop.value.code)


@pytest.mark.parametrize("option", ["--init={}", "--set=distil_from={}"])
def test_a_checkpoint_that_is_none_is_said_before_images_are_read(option, tmp_path, monkeypatch):
    monkeypatch.setattr(train, "load_scenes", lambda *_: pytest.fail("it read images"))
    absent = option.format(tmp_path / "none.pt")
    with pytest.raises(SystemExit, match="no checkpoint"):
        train.run(["--preset", "smoke", absent, "--out", str(tmp_path / "run")])


def test_a_run_that_is_there_is_not_written_over(tmp_path):
    (tmp_path / "last.pt").write_bytes(b"three hours of training")
    with pytest.raises(SystemExit, match=r"is there already: go on with --resume .*last\.pt"):
        train.run(["--preset", "smoke", "--out", str(tmp_path)])
    assert (tmp_path / "last.pt").read_bytes() == b"three hours of training"


def test_a_checkpoint_of_other_widths_or_choices_is_one_line(drawn_scenes, tmp_path):
    path = train.main(replace(SHORT, out=str(tmp_path), max_steps=1), scenes=(drawn_scenes, []))
    with pytest.raises(SystemExit, match="of other widths"):
        train.run(["--resume", str(path), "--set", "network.channels=32"])
    state = load_checkpoint(path)
    torch.save(state | {"config": state["config"] | {"speed": 9}}, path)
    with pytest.raises(SystemExit, match="speed"):
        train.run(["--resume", str(path)])


@pytest.mark.parametrize("wrong", [KeyboardInterrupt(), OSError(28, "No space left", "last.pt")])
def test_an_interrupt_and_a_full_disk_are_one_line(wrong, tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(train, "main", Mock(side_effect=wrong))
    with pytest.raises(SystemExit) as stop:
        train.run(["--preset", "smoke", "--out", str(tmp_path)])
    said = f"{stop.value.code}{capsys.readouterr().err}"
    assert said in ("130interrupted\n", "last.pt: No space left")


@pytest.mark.long
def test_a_minute_of_training_lowers_the_loss_and_beats_the_untrained_network(
    drawn_scenes, tmp_path
):
    config = replace(SHORT, out=str(tmp_path), max_steps=250, batch_pairs=4, bfloat16=True)
    # One thread: two wait for each other when others work.
    config = replace(config, log_every_steps=25)
    path = train.main(config, scenes=(drawn_scenes, []))
    log = np.genfromtxt(tmp_path / "log.csv", delimiter=",", names=True, usecols=range(11))
    matching = log["matching"][
        ~np.isnan(log["matching"])
    ]  # the sharpness of peaks is raised on the way
    assert matching[-1] < 0.75 * matching[0]
    views = validate.calm_views(drawn_scenes, config.samples, 8)
    network = FeatureNetwork(config.network)
    before = validate.score_matches(validate.learned(network), views)
    average = load_checkpoint(path)["average"]
    network.load_state_dict({k: average[f"module.{k}"] for k in network.state_dict()})
    after = validate.score_matches(validate.learned(network), views)
    assert after.inliers > 1.5 * before.inliers
    assert after.precision > before.precision
