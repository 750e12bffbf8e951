"""A GenICam camera as a `Sensor`: set up by features, streamed by a GenTL producer.

Here: `GenicamSensor`: a session from connect to close. Not here: reading (`gs2ci_drivers.streamed_sensor`), which
features make up a set-up (`setup`), the checks of a buffer (`frame_checks`), the producer itself
(`gs2ci_drivers.links.gentl`).
"""

import contextlib
from dataclasses import replace
from typing import Final

from gs2ci.core.clock import Clock
from gs2ci_drivers.failures import DeviceFaultError, DriverError
from gs2ci_drivers.genicam.camera_clock import CameraClock
from gs2ci_drivers.genicam.frame_checks import FIRST_IDS, BufferChecks, TakenFrame
from gs2ci_drivers.genicam.nodes import Features
from gs2ci_drivers.genicam.options import ONLY, GenicamOptions
from gs2ci_drivers.genicam.setup import GenicamSetup, describe_camera
from gs2ci_drivers.genicam.trigger import selected
from gs2ci_drivers.ports import CameraIdentity, CameraPort, FeatureRefusalError, port_errors
from gs2ci_drivers.sensor import SensorConfig, SensorInfo, SensorSettings, TriggerMode
from gs2ci_drivers.streamed_sensor import StreamedSensor

READY_PATIENCE_S: Final = 2.0
"""How long a camera may take from its start until it waits for triggers."""
READY_STEP_S: Final = 2e-3


class GenicamSensor(StreamedSensor[TakenFrame]):
    """A camera behind a GenTL producer.

    Args:
        name: Name of the device in the rig file, for messages.
        port: The camera and its producer, real or a twin's.
        clock: The clock of all waits.
        options: The rig file's table.
    """

    def __init__(self, name: str, port: CameraPort, clock: Clock, options: GenicamOptions) -> None:
        super().__init__(name, clock)
        self._port = port
        self._options = options
        self._features = Features(name, port)
        self._identity: CameraIdentity | None = None
        self._config: SensorConfig | None = None
        self._setup: GenicamSetup | None = None
        self._camera_clock: CameraClock | None = None
        self._found_mode: str | None = None
        self._cleared: GenicamSetup | None = None

    def _do_connect(self) -> SensorInfo:
        with self._noticing_loss():
            return describe_camera(self._features, self._open(), self._options)

    def _do_prepare(self) -> SensorInfo:
        with self._noticing_loss():
            identity = self._open()
            # Once it is configured, its limits are those of a capture.
            if not self._streaming and self._setup is None and self._cleared is None:
                self._cleared = self._clear()
                return describe_camera(self._features, identity, self._options)
        return self.info

    def _clear(self) -> GenicamSetup:
        """Reset what other programs left; return the set-up that has done so, for one configuration."""
        self._remember_trigger()
        setup = GenicamSetup(self.name, self._features, self._options, self.incidents)
        setup.clear()
        return setup

    def _open(self) -> CameraIdentity:
        if self._identity is None:
            serial = "" if self._options.port == ONLY else self._options.port
            with port_errors(self.name, "open"):
                self._identity = self._port.open(self._options.producer, serial)
        return self._identity

    def _do_temperatures_c(self) -> dict[str, float]:
        if self._identity is None:
            return {}
        with self._noticing_loss():  # DeviceTemperature, °C: SFNC's Device Control
            found = self._features.number("DeviceTemperature")
        return {} if found is None else {"DeviceTemperature": found}

    def _do_configure(self, config: SensorConfig) -> SensorSettings:
        with self._noticing_loss():
            self._open()
            self._setup, self._cleared = self._cleared or self._clear(), None
            settings = self._setup.apply(config)
        self._config = config
        return settings

    def _do_start(self) -> None:
        assert self._config is not None  # the base class starts nothing that is not configured
        with self._noticing_loss():
            if self._identity is None or self._setup is None:  # it had disappeared, and has lost its settings
                self._open()
                self._setup, self._cleared = self._clear(), None
                self._setup.apply(self._config)
            self._camera_clock = CameraClock(self._port, self._features)
            try:
                given = self._run(self._setup, self._config)
            except BaseException:
                self._halt()
                raise
            settings = self._setup.settings
            assert settings is not None
            self._settings = replace(settings, buffers=given)
            self._checks = self._new_checks(self._setup)

    def _new_checks(self, setup: GenicamSetup) -> BufferChecks:
        assert setup.settings is not None
        assert self._identity is not None
        stated = self._options.first_frame_id
        known = FIRST_IDS.get(self._identity.transport) if stated is None else stated
        first = () if known is None or known == "any" else (int(known),)
        picture = setup.settings.format
        return BufferChecks(self.name, setup.form, (picture.height, picture.width), first, self._options.stamps)

    def _run(self, setup: GenicamSetup, config: SensorConfig) -> int:
        """Stream the warm-up frames by the camera's own clock, then restart; return the number of buffers."""
        triggered = config.trigger is not TriggerMode.FREE_RUN
        if config.warm_up_frames:
            if triggered:
                setup.set_trigger(TriggerMode.FREE_RUN)
            self._start_port(config, setup)
            self._pass_warm_up(config, self._fetch)
            with port_errors(self.name, "AcquisitionStop"):
                self._port.stop()
            setup.set_trigger(config.trigger)
        given = self._start_port(config, setup)
        assert self._camera_clock is not None
        self._camera_clock.renew()
        if triggered:
            self._wait_until_ready()
        return given

    def _start_port(self, config: SensorConfig, setup: GenicamSetup) -> int:
        with port_errors(self.name, "AcquisitionStart"):
            return self._port.start(config.buffers, setup.chunks)

    def _wait_until_ready(self) -> None:
        """Wait until the camera reports that it waits for triggers, if it can.

        SFNC: AcquisitionStatus; Lucid: TriggerArmed (Arena SDK, example Cpp_Trigger: "Wait until trigger is armed").

        Raises:
            DeviceFaultError: It does not within `READY_PATIENCE_S`.
        """
        features = self._features
        if features.has("AcquisitionStatusSelector", "FrameTriggerWait") and features.has("AcquisitionStatus"):
            features.write("AcquisitionStatusSelector", "FrameTriggerWait")
            name, words = "AcquisitionStatus", "AcquisitionStatus[FrameTriggerWait]"
        elif features.has("TriggerArmed"):
            name = words = "TriggerArmed"
        else:
            return
        until_s = self.clock.now_s() + READY_PATIENCE_S
        while not features.read(name):
            if self.clock.now_s() > until_s:
                raise DeviceFaultError(
                    self.name,
                    "AcquisitionStart",
                    [f"{words} was false for {READY_PATIENCE_S:g} s"],
                    remedy="check trigger_selector and trigger_line in [sensor]: another trigger may be on",
                )
            self.clock.sleep_s(READY_STEP_S)

    def _is_open(self) -> bool:
        return self._identity is not None

    def _fetch(self, timeout_s: float) -> TakenFrame | None:
        """Wait for a buffer and convert its stamp to the computer's clock."""
        camera_clock = self._camera_clock
        assert camera_clock is not None
        if timeout_s > 0:
            camera_clock.renew()
        with port_errors(self.name, "fetch", timeout_s=timeout_s):
            buffer = self._port.fetch(timeout_s)
            if buffer is None:
                return None
            now_ns = self._port.clock_ns()
        ticks = buffer.chunks.get("ChunkTimestamp", buffer.timestamp)
        stamp_ns = None if ticks is None else camera_clock.to_monotonic_ns(int(ticks))
        return TakenFrame(buffer, stamp_ns, now_ns, round((camera_clock.uncertainty_s or 0.0) * 1e9))

    def _do_stop(self) -> None:
        self._checks = None
        with self._noticing_loss(), port_errors(self.name, "AcquisitionStop"):
            if self._identity is not None:
                self._port.stop()

    def _probe(self) -> None:
        self._features.read("PixelFormat")

    def _do_close(self) -> None:
        self._halt()
        try:
            with contextlib.suppress(DriverError):
                self._put_trigger_back()
        finally:
            self._port.close()

    def _remember_trigger(self) -> None:
        """Store the trigger mode that was found, once, so that it can be restored."""
        if self._found_mode is None and self._features.has("TriggerMode"):
            self._features.write_if_there("TriggerSelector", selected(self._features, self._options))
            self._found_mode = str(self._features.read("TriggerMode"))

    def _put_trigger_back(self) -> None:
        if self._identity is not None and self._found_mode is not None:
            self._features.write_if_there("TriggerSelector", selected(self._features, self._options))
            self._features.write("TriggerMode", self._found_mode)

    def _halt(self) -> None:
        with contextlib.suppress(OSError, FeatureRefusalError):
            self._port.stop()

    def _let_go(self) -> None:
        self._halt()
        self._port.close()
        self._identity, self._setup, self._checks, self._cleared = None, None, None, None
