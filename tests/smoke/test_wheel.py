"""What `make wheel` makes is small, whole, and runs where only it is installed."""

import subprocess
import sys
import venv
import zipfile
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
MOST_MB = 15.0
MODELS = ("default", "default_int8", "default_open", "nano", "nano_int8")


def run(command: list[object], **options) -> subprocess.CompletedProcess[str]:
    done = subprocess.run(list(map(str, command)), capture_output=True, text=True, **options)
    assert done.returncode == 0, done.stderr[-3000:]
    return done


@pytest.fixture(scope="module")
def wheel(tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("dist")
    run([sys.executable, "-m", "pip", "wheel", "--quiet", "--no-deps", "-w", folder, ROOT])
    return next(folder.glob("vwnav-*.whl"))


@pytest.mark.long
def test_the_wheel_is_small_and_holds_weights_and_routes(wheel):
    assert wheel.stat().st_size < MOST_MB * 1e6
    with zipfile.ZipFile(wheel) as archive:
        names = set(archive.namelist())
    assert {f"vwnav/weights/vwnav_{name}.onnx" for name in MODELS} <= names
    assert any(name.startswith("vwnav/sim/routes/") for name in names)
    assert not any(name.startswith(("tests/", "training/", "models/")) for name in names)


@pytest.mark.long
def test_it_runs_where_only_it_is_installed(wheel, tmp_path):
    venv.create(tmp_path / "venv", with_pip=True)
    programs = tmp_path / "venv" / "bin"
    run([programs / "pip", "install", "--quiet", wheel])
    clean = {"PATH": "/usr/bin:/bin", "HOME": str(tmp_path)}
    assert "doctor" in run([programs / "vwnav", "--help"], cwd=tmp_path, env=clean).stdout
    help_text = run([programs / "vwnav", "doctor", "--help"], cwd=tmp_path, env=clean).stdout
    assert "--connection" in help_text
    script = (
        "import vwnav\nfrom pathlib import Path\n"
        "from vwnav.vision.features.learned import LearnedFeatures\n"
        "from vwnav.sim.named_sites import parse_site\n"
        f"assert Path(vwnav.__file__).is_relative_to({str(tmp_path)!r})\n"
        f"[LearnedFeatures(Path(name)) for name in {MODELS!r}]\n"
        "assert parse_site('sim:default').render('map', 0.0, 0.0, (64, 64), 0.3).shape[:2]"
        " == (64, 64)\n"
    )
    run([programs / "python", "-c", script], cwd=tmp_path, env=clean)
