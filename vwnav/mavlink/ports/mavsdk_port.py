"""MAVSDK as a port for single MAVLink messages: opens, subscribes, sends, closes.

MAVSDK's `mavlink_direct` carries every message as JSON (null is NaN). Its callback interface is
used, not the asyncio one on top of it: one thread hop less between the air and the attitude.
MAVSDK's offboard plugin is left alone on purpose: it repeats the last setpoint by itself, so a hung
control loop would go on flying. What is sent here stops when the loop stops.
"""

import json
import logging
import os
import threading
import time
from collections.abc import Callable
from typing import Any

from mavsdk import ComponentType, Configuration, LogLevel, Mavsdk, log_subscribe  # type: ignore[import-untyped]
from mavsdk.plugins.mavlink_direct import (  # type: ignore[import-untyped]
    MavlinkDirect,
    MavlinkDirectError,
    MavlinkDirectResult,
    MavlinkMessage,
)

from vwnav.errors import LinkError
from vwnav.mavlink.ports.port import Fields, Handler, Listener, Sender

_log = logging.getLogger(__name__)
_mavsdk_log = logging.getLogger("mavsdk")
_AUTOPILOT_COMPONENT = 1
_LOOK_S = 0.25
_LEVELS = {
    LogLevel.DEBUG: logging.DEBUG,
    LogLevel.INFO: logging.DEBUG,
    LogLevel.WARN: logging.INFO,
    LogLevel.ERROR: logging.WARNING,
}
_ANY = (0, None)  # target of a broadcast, or of a message from before there were targets
# Where C++ looks for a temporary folder, the first that is set; else in /tmp.
_TEMPORARY_FOLDERS = ("TMPDIR", "TMP", "TEMP", "TEMPDIR")
_MISTAKES = (MavlinkDirectResult.INVALID_MESSAGE, MavlinkDirectResult.INVALID_FIELD)


def _log_line(level: LogLevel, message: str, _file: str | None, _line: int) -> bool:
    _mavsdk_log.log(_LEVELS[level], "%s", message)
    return True  # MAVSDK itself would print to stdout, which is for results


def _forget_missing_folders() -> None:
    """MAVSDK ends the process at the first autopilot when the temporary folder is none."""
    for name in _TEMPORARY_FOLDERS:
        if not os.path.isdir(os.environ.get(name, "/")):
            _log.warning("%s is no folder: %s is not used", os.environ.pop(name), name)


class MavlinkPort:
    """The link to one autopilot: a `port.Port`.

    Args:
        url: MAVSDK connection URL.
        as_ground_station: call ourselves a ground station instead of a companion computer.
        timeout_s: how long an autopilot is waited for.
        clock: monotonic clock that stamps what is received.
        system_id: of the autopilot that is wanted; 0 for the first that is heard.
        link_url: what the operator calls the link, when `url` is that of a relay in front of it.

    Raises:
        LinkError: the URL is wrong, or no autopilot is on the link.
    """

    def __init__(
        self,
        url: str,
        as_ground_station: bool,
        timeout_s: float,
        clock: Callable[[], float],
        system_id: int = 0,
        link_url: str | None = None,
    ) -> None:
        self._clock = clock
        self._link_url = link_url or url
        self._is_chosen = system_id != 0
        log_subscribe(_log_line)
        _forget_missing_folders()
        role = (
            ComponentType.GROUND_STATION if as_ground_station else ComponentType.COMPANION_COMPUTER
        )
        configuration = Configuration.create_with_component_type(role)
        self._own_system, self._own_component = configuration.system_id, configuration.component_id
        self._mavsdk = Mavsdk(configuration)
        try:
            system = self._find_autopilot(url, timeout_s, system_id)
            self._system_id = int(system.get_system_id())
            self._direct = MavlinkDirect(system)
        except BaseException:
            self._mavsdk.destroy()
            raise
        self._closed = False
        self._closing = threading.Lock()
        self._listeners: dict[str, Listener] = {}
        self._others: dict[int, MavlinkDirect] = {}  # by their system, the autopilot's own too
        self._system_count = 0

    @property
    def system_id(self) -> int:
        """Of the autopilot."""
        return self._system_id

    @property
    def strangers(self) -> tuple[int, ...]:
        """Systems of other autopilots on the link, where nobody has said which one is ours."""
        if self._is_chosen:
            return ()
        return tuple(heard for heard in self._heard() if heard != self._system_id)

    def subscribe(self, name: str, handler: Handler) -> None:
        """Hand every message `name` of the autopilot to `handler`, on MAVSDK's thread."""
        sender = (self.system_id, _AUTOPILOT_COMPONENT)

        def receive(message: Any, _: Any) -> None:
            received_s = self._clock()
            if (message.system_id, message.component_id) == sender:
                handler(name, json.loads(message.fields_json), received_s)

        self._direct.subscribe_message(name, receive)

    @property
    def own_id(self) -> Sender:
        """System and component that we are."""
        return self._own_system, self._own_component

    def listen(self, name: str, listener: Listener) -> None:
        """Hand every message `name` of whoever else is on the link to `listener`.

        MAVSDK hands out messages system by system: each that appears is subscribed to anew.
        """
        self._listeners[name] = listener
        for direct in self._others.values():
            _listen(direct, name, listener)

    def is_for_us(self, fields: Fields) -> bool:
        """Whether a message that has a target is ours; others speak with the autopilot too."""
        return (
            fields.get("target_system") in (*_ANY, self._own_system)
            and fields.get("target_component") in (*_ANY, self._own_component)
        )  # fmt: skip

    def send(self, name: str, fields: Fields) -> None:
        """Send one message; a link that is down or closed loses it, as the air would.

        Raises:
            ValueError: there is no such message or field.
        """
        message = MavlinkMessage(name, 0, 0, 0, 0, json.dumps(fields, allow_nan=False))
        with self._closing:
            if self._closed:
                return
            if self._system_count != self._mavsdk.system_count():
                self._meet_others()
            try:
                self._direct.send_message(message)
            except MavlinkDirectError as error:
                if error.result in _MISTAKES:
                    raise ValueError(f"{name} {fields}: {error.result.name}") from error
                _log.debug("%s was not sent: %s", name, error.result.name)

    def _meet_others(self) -> None:
        """Listen to systems that have appeared: ground stations, and what else is on board."""
        systems = self._mavsdk.get_systems()
        self._system_count = len(systems)
        for system in systems:
            number = int(system.get_system_id())
            if number not in self._others:
                self._others[number] = MavlinkDirect(system)
                for name, listener in self._listeners.items():
                    _listen(self._others[number], name, listener)

    def close(self) -> None:
        """Give the link back."""
        with self._closing:
            if self._closed:
                return
            self._closed = True
        self._mavsdk.destroy()

    def _find_autopilot(self, url: str, timeout_s: float, system_id: int) -> Any:
        result = self._mavsdk.add_any_connection(url)
        if result.name != "SUCCESS":
            what = result.name.lower().replace("_", " ")
            raise LinkError(f"cannot open the link {url}: {what}; check the URL and the device")
        until_s = time.monotonic() + timeout_s
        while time.monotonic() < until_s:  # in short looks, so that Ctrl-C is heard
            system = self._look(system_id)
            if system is not None:
                return system
        if others := self._heard():
            raise LinkError(
                f"no autopilot of system {system_id} on {self._link_url} within {timeout_s:.0f} s, "
                f"but of {' and '.join(map(str, others))}: is [flight] autopilot_id right?"
            )
        raise LinkError(
            f"no autopilot on {self._link_url} within {timeout_s:.0f} s: check its power, the "
            "cable, the baud rate, and that it sends MAVLink on that port"
        )

    def _heard(self) -> list[int]:
        """Systems of the autopilots on the link."""
        systems = self._mavsdk.get_systems()
        autopilots = [each for each in systems if each.has_autopilot() and each.is_connected()]
        return sorted({int(each.get_system_id()) for each in autopilots})

    def _look(self, system_id: int) -> Any | None:
        if not system_id:
            return self._mavsdk.first_autopilot(_LOOK_S)
        for system in self._mavsdk.get_systems():
            if system.get_system_id() == system_id and system.has_autopilot():
                return system
        time.sleep(_LOOK_S)
        return None


def _listen(direct: Any, name: str, listener: Listener) -> None:
    def receive(message: Any, _: Any) -> None:
        if message.component_id != _AUTOPILOT_COMPONENT:
            listener(json.loads(message.fields_json), (message.system_id, message.component_id))

    direct.subscribe_message(name, receive)
