#!/bin/sh
# Sets a Raspberry Pi up for vwnav: Raspberry Pi OS Bookworm or Trixie, 64 bits.
#
#     sudo ./first-run.sh vwnav-VERSION-py3-none-any.whl
#     ./first-run.sh --root DIR WHEEL     writes files below DIR, and says what it would run
#
# It can be run again: for a newer wheel, or when it broke off. What a person wrote into
# /etc/vwnav/flight.env stays.
set -eu

root=
wheel=
while [ $# -gt 0 ]; do
    case $1 in
    --root)
        [ $# -ge 2 ] || { echo "first-run: --root wants a folder" >&2; exit 2; }
        root=${2%/}
        shift
        ;;
    -*)
        echo "first-run: no option $1" >&2
        exit 2
        ;;
    *)
        [ -z "$wheel" ] || { echo "first-run: one wheel, not $wheel and $1" >&2; exit 2; }
        wheel=$1
        ;;
    esac
    shift
done
here=$(dirname "$0")
mark="# vwnav: the autopilot's serial port"

fail() {
    echo "first-run: $1" >&2
    exit 1
}

run() {
    if [ -n "$root" ]; then
        echo "would run: $*"
    else
        "$@"
    fi
}

# Copy a file of this folder to its place, if it is not there as it is.
place() {
    if ! cmp -s "$here/$1" "$root$2"; then
        mkdir -p "$(dirname "$root$2")"
        cp "$here/$1" "$root$2"
        chmod 644 "$root$2"
        echo "written: $2"
    fi
}

check_system() {
    [ -n "$wheel" ] || fail "which wheel? first-run.sh [--root DIR] vwnav-VERSION-py3-none-any.whl"
    [ -f "$wheel" ] || fail "there is no $wheel"
    [ -n "$root" ] || [ "$(id -u)" = 0 ] || fail "run it with sudo"
    codename=$(sed -n 's/^VERSION_CODENAME=//p' "$root/etc/os-release" 2>/dev/null || true)
    case $codename in
    bookworm | trixie) ;;
    *) fail "Raspberry Pi OS Bookworm or Trixie is needed, this is '${codename:-unknown}'" ;;
    esac
    [ -f "$root/boot/firmware/config.txt" ] || fail "no /boot/firmware/config.txt: not a Raspberry Pi"
    [ -n "$root" ] || [ "$(uname -m)" = aarch64 ] || fail "the 64-bit system is needed (aarch64)"
}

set_up_serial_port() {
    config=$root/boot/firmware/config.txt
    if ! grep -qxF "$mark" "$config"; then
        cat >>"$config" <<END

$mark
[all]
enable_uart=1
dtoverlay=disable-bt
[pi5]
dtparam=uart0=on
[all]
END
        echo "the serial port on pins 8 and 10 is switched on"
        reboot=yes
    fi
    cmdline=$root/boot/firmware/cmdline.txt
    console='console=(serial0|ttyAMA0)(,[^ ]*)?'
    if grep -qE "$console" "$cmdline"; then
        # A line may name the port twice, by both names, and end in its parity (115200n8).
        sed -E "s/$console ?//g" "$cmdline" >"$cmdline.new"
        mv "$cmdline.new" "$cmdline"
        echo "the serial port is the autopilot's now, not a console's"
        reboot=yes
    fi
}

install_program() {
    run apt-get install -y --no-install-recommends python3-venv python3-picamera2 v4l-utils
    run sh -c "id vwnav >/dev/null 2>&1 || useradd --system --home-dir /var/lib/vwnav --groups dialout,video vwnav"
    run python3 -m venv --system-site-packages /opt/vwnav
    # A wheel of the version that is there already would be passed over, whatever is in it; once
    # it is in, what it depends on is looked up in it, not in the one before.
    run /opt/vwnav/bin/pip install --force-reinstall --no-deps "$wheel"
    run /opt/vwnav/bin/pip install --upgrade "$wheel"
    run /opt/vwnav/bin/vwnav --version
    echo "installed from: $(sha256sum "$wheel")"
    run install -d -o vwnav -g vwnav /var/lib/vwnav
}

reboot=no
check_system
install_program
place vwnav.service /etc/systemd/system/vwnav.service
place 99-vwnav.rules /etc/udev/rules.d/99-vwnav.rules
place journald-vwnav.conf /etc/systemd/journald.conf.d/vwnav.conf
place watchdog-vwnav.conf /etc/systemd/system.conf.d/vwnav.conf
[ -f "$root/etc/vwnav/flight.env" ] || place flight.env /etc/vwnav/flight.env
set_up_serial_port
run udevadm control --reload
run systemctl daemon-reload
run systemctl restart systemd-journald
run sudo -u vwnav /opt/vwnav/bin/vwnav doctor || true
[ "$reboot" = no ] || echo "Reboot once: the boot settings were changed."
echo "Set what is flown in /etc/vwnav/flight.env, then: sudo systemctl enable --now vwnav"
