#!/bin/sh
# Sets up an emulated aarch64 Debian, as on a Raspberry Pi, on an x86 machine: for `make test-arm`.
#
#     deploy/aarch64.sh [FOLDER]      FOLDER is .aarch64 when not given; 1 GB
#
# Needs qemu-user-static and mmdebstrap (apt-get install qemu-user-static mmdebstrap), and neither
# chroot nor binfmt. FOLDER/python is the interpreter: of the tree FOLDER/root, with the wheels of
# pyproject.toml's dependencies in FOLDER/site. Can be run again; what is there stays. Take the
# folder away for newer wheels.
set -eu

repository=$(cd "$(dirname "$0")/.." && pwd)
folder=${1:-$repository/.aarch64}
host_python=${PYTHON:-python3}
mkdir -p "$folder"
folder=$(cd "$folder" && pwd)
root=$folder/root

for tool in qemu-aarch64-static mmdebstrap "$host_python"; do
    command -v "$tool" >/dev/null || {
        echo "aarch64.sh: $tool is missing (apt-get install qemu-user-static mmdebstrap)" >&2
        exit 1
    }
done

if [ ! -e "$root/usr/bin/python3.11" ]; then
    echo "a Debian tree in $root"
    rm -rf "$root"
    mmdebstrap --quiet --variant=extract --architectures=arm64 \
        --include=python3.11,libpython3.11-stdlib,libstdc++6,libgomp1,libgl1,libglib2.0-0 \
        bookworm "$root"
fi

# onnxruntime asks which processor it is on before it loads, and dies without an answer.
mkdir -p "$root/proc" "$root/sys/devices/system/cpu"
for core in 0 1 2 3; do
    printf 'processor\t: %s\nBogoMIPS\t: 108.00\nFeatures\t: fp asimd evtstrm crc32 cpuid\n' "$core"
    printf 'CPU implementer\t: 0x41\nCPU architecture: 8\nCPU variant\t: 0x0\n'
    printf 'CPU part\t: 0xd08\nCPU revision\t: 3\n\n'
done >"$root/proc/cpuinfo"
for name in possible present online; do
    echo 0-3 >"$root/sys/devices/system/cpu/$name"
done

if [ ! -e "$folder/wheels.txt" ]; then
    echo "wheels of what flies in $folder/site"
    rm -rf "$folder/wheels" "$folder/site"
    "$host_python" - "$repository/pyproject.toml" >"$folder/requirements.txt" <<'END'
import sys
import tomllib

with open(sys.argv[1], "rb") as file:
    print(*tomllib.load(file)["project"]["dependencies"], sep="\n")
END
    "$host_python" -m pip download --quiet --dest "$folder/wheels" --only-binary=:all: \
        --python-version 3.11 --implementation cp \
        --platform manylinux_2_28_aarch64 --platform manylinux_2_27_aarch64 \
        --platform manylinux_2_26_aarch64 --platform manylinux_2_17_aarch64 \
        --platform manylinux2014_aarch64 -r "$folder/requirements.txt"
    for wheel in "$folder"/wheels/*.whl; do
        "$host_python" -m zipfile -e "$wheel" "$folder/site"
    done
    for wheel in "$folder"/wheels/*.whl; do
        basename "$wheel" | cut -d- -f1,2
    done >"$folder/wheels.txt"
fi

# argv[0] is this script, so that a Python there starts its children through it, too.
cat >"$folder/python" <<END
#!/bin/sh
# The emulated interpreter. VWNAV_CPU: what to be; VWNAV_SOURCE: the program's own folder.
export PYTHONHOME="$root/usr" PYTHONPATH="\${VWNAV_SOURCE:-$repository}:$folder/site"
exec qemu-aarch64-static -cpu "\${VWNAV_CPU:-cortex-a72}" -L "$root" -0 "$folder/python" \\
    "$root/usr/bin/python3.11" "\$@"
END
chmod +x "$folder/python"

# As pip does on a board: compiling is slow there, and takes 110 MB more than importing.
"$folder/python" -m compileall -q "$folder/site"
echo "ready: $folder/python"
