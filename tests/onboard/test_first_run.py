"""The script that sets a Raspberry Pi up, run on folders that look like one."""

import hashlib
import shutil
import subprocess
from pathlib import Path

import pytest

SCRIPT = Path(__file__).resolve().parents[2] / "deploy" / "first-run.sh"
MARK = "# vwnav: the autopilot's serial port"
WRITTEN = [
    "etc/systemd/journald.conf.d/vwnav.conf",
    "etc/systemd/system.conf.d/vwnav.conf",
    "etc/systemd/system/vwnav.service",
    "etc/udev/rules.d/99-vwnav.rules",
    "etc/vwnav/flight.env",
]


@pytest.fixture(params=["bookworm", "trixie"])
def board(tmp_path, request):
    root = tmp_path / "root"
    (root / "etc").mkdir(parents=True)
    (root / "boot" / "firmware").mkdir(parents=True)
    (root / "etc" / "os-release").write_text(f"ID=debian\nVERSION_CODENAME={request.param}\n")
    (root / "boot/firmware/config.txt").write_text("camera_auto_detect=1\n\n[cm4]\notg_mode=1\n")
    (root / "boot/firmware/cmdline.txt").write_text(
        "console=serial0,115200 console=tty1 root=PARTUUID=1-02 rootwait\n"
    )
    (tmp_path / "vwnav-1.0-py3-none-any.whl").touch()
    return root


def first_run(root: Path, *arguments: str) -> subprocess.CompletedProcess[str]:
    wheel = str(root.parent / "vwnav-1.0-py3-none-any.whl")
    command = [str(SCRIPT), "--root", str(root), *(arguments or [wheel])]
    return subprocess.run(command, capture_output=True, text=True)


def content(root: Path) -> dict[str, bytes]:
    return {str(p.relative_to(root)): p.read_bytes() for p in root.rglob("*") if p.is_file()}


def test_it_sets_a_board_up_and_changes_nothing_the_second_time(board):
    before = set(content(board))
    first = first_run(board)
    assert first.returncode == 0, first.stderr
    after = content(board)
    assert sorted(set(after) - before) == WRITTEN
    config = after["boot/firmware/config.txt"].decode().splitlines()
    assert config[:3] == ["camera_auto_detect=1", "", "[cm4]"]
    assert config[-6:-3] == ["[all]", "enable_uart=1", "dtoverlay=disable-bt"]
    assert after["boot/firmware/cmdline.txt"] == b"console=tty1 root=PARTUUID=1-02 rootwait\n"
    assert "Reboot once" in first.stdout

    second = first_run(board)
    assert second.returncode == 0, second.stderr
    assert content(board) == after
    assert "Reboot once" not in second.stdout
    assert "written:" not in second.stdout


def test_what_a_person_set_stays_and_what_is_ours_is_renewed(board):
    first_run(board)
    (board / "etc/vwnav/flight.env").write_text('VWNAV_FLY="--arm"\n')
    (board / "etc/systemd/system/vwnav.service").write_text("of an older version\n")
    first_run(board)
    assert (board / "etc/vwnav/flight.env").read_text() == 'VWNAV_FLY="--arm"\n'
    unit = SCRIPT.with_name("vwnav.service").read_text()
    assert (board / "etc/systemd/system/vwnav.service").read_text() == unit


def test_a_wheel_of_the_version_that_is_there_is_installed_all_the_same(board):
    wheel = board.parent / "vwnav-1.0-py3-none-any.whl"
    wheel.write_bytes(b"mended")
    said = first_run(board).stdout.splitlines()
    pip = [line for line in said if line.startswith("would run: /opt/vwnav/bin/pip")]
    assert pip == [
        f"would run: /opt/vwnav/bin/pip install --force-reinstall --no-deps {wheel}",
        f"would run: /opt/vwnav/bin/pip install --upgrade {wheel}",
    ]
    after = said[said.index(pip[-1]) + 1 :]
    assert after[0] == "would run: /opt/vwnav/bin/vwnav --version"
    assert after[1] == f"installed from: {hashlib.sha256(b'mended').hexdigest()}  {wheel}"


@pytest.mark.parametrize(
    "consoles",
    [
        "console=serial0,115200 console=ttyAMA0,115200 ",
        "console=ttyAMA0,115200n8 console=serial0 ",
    ],
)
def test_a_port_that_is_named_twice_is_taken_off_the_console(board, consoles):
    path = board / "boot/firmware/cmdline.txt"
    path.write_text(f"{consoles}console=tty1 console=ttyAMA10,115200 root=x\n")
    first = first_run(board)
    assert path.read_text() == "console=tty1 console=ttyAMA10,115200 root=x\n"
    assert "Reboot once" in first.stdout
    assert "Reboot once" not in first_run(board).stdout


def test_settings_behind_the_section_of_another_board_are_for_all(board):
    path = board / "boot/firmware/config.txt"
    path.write_text("[all]\nenable_uart=1\n[pi5]\nkernel=x\n")
    first_run(board)
    section, found = "", {}
    for line in path.read_text().splitlines():
        section = line if line.startswith("[") else section
        found.setdefault(section, []).append(line)
    assert {"enable_uart=1", "dtoverlay=disable-bt"} < set(found["[all]"])
    assert found["[pi5]"] == ["[pi5]", "kernel=x", "", MARK, "[pi5]", "dtparam=uart0=on"]


def test_what_is_wrong_is_one_line(board, tmp_path):
    missing = first_run(board, str(tmp_path / "none.whl"))
    assert (missing.returncode, missing.stderr.count("\n")) == (1, 1)
    assert "there is no" in missing.stderr
    assert first_run(board, "--force").returncode == 2
    (board / "etc" / "os-release").write_text("VERSION_CODENAME=bullseye\n")
    old = first_run(board)
    assert (old.returncode, old.stderr.count("\n")) == (1, 1)
    assert "'bullseye'" in old.stderr
    assert not (board / "etc" / "vwnav").exists()


@pytest.mark.skipif(shutil.which("shellcheck") is None, reason="needs shellcheck")
def test_the_scripts_are_clean_shell():
    scripts = sorted(str(path) for path in SCRIPT.parent.glob("*.sh"))
    done = subprocess.run(["shellcheck", *scripts], capture_output=True, text=True)
    assert done.returncode == 0, done.stdout


def test_of_two_wheels_none_is_chosen(board):
    before = content(board)
    wheels = (str(board.parent / f"vwnav-{version}-py3-none-any.whl") for version in (1.0, 1.1))
    done = first_run(board, *wheels)
    assert done.returncode == 2
    assert "one wheel" in done.stderr
    assert content(board) == before
