"""A bench, real or simulated: `open_rig` and the methods of an open rig.

Here: `OpenRig`, which opens its devices when first needed and closes them at the end; `find_devices`. Not here: any of
the work (`gs2ci.rig`, `gs2ci_calibration`).
"""

import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Final, Literal, Self

from gs2ci.api.display import shown
from gs2ci.api.live_page import LivePage
from gs2ci.api.options import check_whole
from gs2ci.core.progress import Progress
from gs2ci.core.records import Shot

if TYPE_CHECKING:
    from gs2ci.api.display.stages import StageDisplay
    from gs2ci.rig.calibrated import Calibrated
    from gs2ci.rig.doctor import BenchFinding
    from gs2ci.rig.opening import Rig
    from gs2ci.rig.recording import Prepared
    from gs2ci.rig.session import SessionLog
    from gs2ci_calibration.bench import Bench
    from gs2ci_calibration.bundle import Bundle
    from gs2ci_calibration.drift import Change
    from gs2ci_calibration.estimates import Section
    from gs2ci_drivers.acquisition import Devices

CalibrationStep = Literal["dark-flat", "sensor", "timing", "registration", "masks", "camera", "stage", "all"]
_NEVER: Final[Callable[[Path], object]] = lambda partial: None  # noqa: E731  a default that does nothing


class OpenRig:
    """A bench as described by its rig file; made by `open_rig`.

    Devices are opened when first needed, and closed with the rig. Interrupting any call leaves them at rest: the
    sensor off, the modulator dark, the stage stopped.

    Args:
        path: The rig file (TOML).

    Example:
        >>> with gs2ci.open_rig("rig.toml") as rig:
        ...     rig.name, rig.simulated, rig.capture(progress=gs2ci.Silent()).views
        ('small bench', True, 4)
    """

    def __init__(self, path: str | Path) -> None:
        from gs2ci.rig.opening import load_rig

        self._rig = load_rig(Path(path))
        self._devices: Devices | None = None
        self._traced: Path | None = None
        self._session: SessionLog | None = None

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    @property
    def name(self) -> str:
        """Get the name of the bench in the rig file."""
        return self._rig.table.name

    @property
    def simulated(self) -> bool:
        """Get whether its devices are simulated."""
        return self._rig.bench is not None

    @property
    def rig(self) -> "Rig":
        """Get the rig as `gs2ci.rig` knows it."""
        return self._rig

    @property
    def devices(self) -> "Devices":
        """Get the open devices.

        Raises:
            DeviceError: A port cannot be opened; those already open are closed again.
        """
        if self._devices is None:
            self._devices = self._rig.open(self._traced, self._session)
        return self._devices

    @property
    def opened(self) -> "Devices | None":
        """Get the devices if they are open; opens none."""
        return self._devices

    def close(self) -> None:
        """Close the devices, if any is open. The next call that needs them opens them again."""
        devices, self._devices = self._devices, None
        if devices is not None:
            devices.close()

    def trace_to(self, stem: Path | None) -> None:
        """Log the bytes on every wire in `<stem>.<device>.wire` if the rig file requests it; before opening."""
        self._traced = stem if self._rig.table.trace else None

    def log_to(self, shot: Path | None) -> None:
        """Keep a session log next to a shot file, from the opening of the devices on; before opening."""
        from gs2ci.rig.session import SessionLog

        self._session = None if shot is None else SessionLog(shot, self._rig.table.session)

    def plan(
        self,
        *,
        shots: int | None = None,
        seed: int | None = None,
        calibration: str | Path | None = None,
        probe: bool = False,
        progress: Progress | None = None,
    ) -> "Prepared":
        """Check a capture against the devices' limits; nothing moves and, without a probe, nothing is uploaded.

        Args:
            shots: Number of shots, instead of the rig file's.
            seed: Of the random masks, instead of the rig file's.
            calibration: Bundle with the masks to use, instead of the one named in the rig file's [calibration].
            probe: Show one mask of the bundle and check whether it still fits; needs a lit scene at rest.
            progress: Receives the stages and steps.

        Returns:
            `plan`, with every figure beside its limit; `codes`, the masks; `calibrated`, the bundle.

        Raises:
            DeviceError: A device does not answer or rejects its settings, or the bundle does not fit.
            InputError: The masks do not fit on the modulator.
        """
        check_whole("--shots", shots, 1, remedy="leave --shots out for the rig file's number")
        from gs2ci.rig.recording import prepare

        table = self._rig.table
        try:
            if shots is not None:
                self._rig.set_shots(shots)
            if seed is not None:
                self._rig.set_seed(seed)
            with shown(progress) as display:
                calibrated = self._calibrated(calibration, probe, display)
                return prepare(self._rig, self.devices, calibrated)
        finally:
            self._rig.table = table  # the next plan uses the file's numbers again

    def capture(
        self,
        *,
        calibration: str | Path | None = None,
        probe: bool = True,
        progress: Progress | None = None,
    ) -> Shot:
        """Take one coded exposure and return it; `record` keeps exposures in a file.

        Args:
            calibration: As for `plan`.
            probe: Likewise.
            progress: Receives the stages and steps.

        Returns:
            The shot; with the truth if the bench is simulated. With `mode = "per-mask"`, that of the first mask.

        Raises:
            DeviceError: A device failed, or the plan breaks limits; all are at rest.
        """
        from gs2ci.core.storage import read_shot

        with tempfile.TemporaryDirectory(prefix="gs2ci-") as scratch, shown(progress) as display:
            prepared = self.plan(shots=1, calibration=calibration, probe=probe, progress=display)
            return read_shot(self.record(Path(scratch) / "shot.h5", prepared, progress=display))

    def record(
        self,
        path: str | Path,
        prepared: "Prepared | None" = None,
        *,
        overwrite: bool = False,
        progress: Progress | None = None,
        saved: Callable[[Path], object] = _NEVER,
        until: str | None = None,
    ) -> Path:
        """Take coded exposures into a shot file; each is safe on disk as soon as it is taken.

        Args:
            path: The shot file, ends in .h5; while it grows it is `<path>.partial`, which `recover` reads.
            prepared: From `plan`; the rig file's own capture if None.
            overwrite: Replace a finished file of that name.
            progress: Receives upload and shots.
            saved: Called with the `.partial` file if the capture ends early after some shots.
            until: Take no more than it takes: for views of an accuracy ("35dB"), for depth ("depth 1%"), both by the
                standard errors of the exposures reconstructed together, or for a time ("10min"). The plan says how
                many at most.

        Returns:
            The shot file.

        Raises:
            DeviceError: A device failed, or the plan breaks limits; all are at rest.
            StorageError: The file exists or cannot be written.
            InputError: `until` asks for something else, or the plan's exposures cannot be judged one after another.
        """
        from gs2ci.core.storage.sealing import check_target
        from gs2ci.rig.recording import record
        from gs2ci.rig.until import MOST, CaptureTarget, Until, check_judged, solve_together

        path, target = Path(path), None if until is None else CaptureTarget.parse(until)
        check_target(path, replace=overwrite, remedy="choose another name with -o, or add --overwrite to replace it")
        if self._devices is None and self._session is None:
            self.log_to(path)
        with shown(progress) as display:
            most = None if target is None else MOST
            prepared = prepared or self.plan(shots=most, probe=True, progress=display)
            enough = None
            if target is not None:
                check_judged(prepared.plan)
                most = prepared.plan.settings.shots
                enough = Until(target, most, self.devices.clock.now_s, display.say, solve_together)
            # A second capture into another file gets its own log.
            session, self._session = self._session, None
            if session is not None and session.shot != path:
                session = None
            return record(
                self._rig,
                self.devices,
                prepared,
                path,
                replace=overwrite,
                progress=display,
                saved=saved,
                session=session,
                enough=enough,
            )

    def calibrate(
        self,
        path: str | Path,
        step: CalibrationStep = "all",
        *,
        fast: bool = False,
        on_section: Callable[["Section"], object] | None = None,
        progress: Progress | None = None,
    ) -> "Bundle":
        """Measure the bench into a calibration bundle; sections that are not measured now are kept.

        Args:
            path: The bundle, ends in .h5.
            step: What to measure; "all" runs every step in order.
            fast: Predict the masks from geometry, blur and contrast instead of measuring each.
            on_section: Called with each section after it is in the bundle.
            progress: Receives the stages and steps; on a real bench it requests lens cap, even light, board and scene.

        Returns:
            The bundle.

        Raises:
            DeviceError: A device failed, or a measurement is not good enough (`CalibrationError`); the bundle keeps
                its earlier sections.
            StorageError: The bundle cannot be written.

        Example:
            >>> with gs2ci.open_rig("rig.toml") as rig:
            ...     bundle = rig.calibrate("bench.cal.h5", "dark-flat", progress=gs2ci.Silent())
            >>> list(bundle.sections)
            ['dark-flat']
        """
        from gs2ci.rig.calibrating import provenance_of
        from gs2ci_calibration.bundle import Bundle, add_section, check_bundle_place, check_target, read_bundle
        from gs2ci_calibration.procedures import PROCEDURES

        path = Path(path)
        check_bundle_place(path)
        if path.exists():
            read_bundle(path)  # one that is damaged is told before any device is opened
        with shown(progress) as display:
            bench = self._bench(display, fast=fast)
            provenance = provenance_of(self._rig, self.devices)
            check_target(path, provenance, step)
            for name in _every_step(bench) if step == "all" else (step,):
                known = read_bundle(path) if path.exists() else Bundle()
                bench.progress.say(f"{name}:")
                section = PROCEDURES[name](bench, known)
                display.finish()
                add_section(path, section, provenance)
                if on_section is not None:
                    on_section(section)
        return read_bundle(path)

    def drift(self, path: str | Path, *, progress: Progress | None = None) -> "tuple[list[Change], tuple[str, ...]]":
        """Measure with a few frames how far the bench has drifted since its calibration.

        Args:
            path: The bundle.
            progress: Receives the stages and steps.

        Returns:
            Each change with its standard error and limit, and remarks on how well the bundle fits.

        Raises:
            DeviceError: A device failed, or the bundle does not fit any more (`CalibrationError`).
            StorageError: The bundle cannot be read.
        """
        from gs2ci.rig.calibrating import provenance_of
        from gs2ci_calibration.bundle import read_bundle
        from gs2ci_calibration.drift import changes_since
        from gs2ci_calibration.fitting import fit

        with shown(progress) as display:
            bundle, bench = read_bundle(Path(path)), self._bench(display, fast=False)
            days = self._rig.table.calibration.max_age_days
            found = fit(bundle, bench, provenance_of(self._rig, self.devices), days)
            found.require(bundle)
            changes = changes_since(bench, bundle)
            display.finish()
            return changes, found.notes

    def doctor(self, *, trigger_loop: bool = True) -> "Iterator[BenchFinding]":
        """Check the bench: permissions, firmware, faults, clocks and the trigger line. The stage does not move.

        Args:
            trigger_loop: Show eight masks and count the frames that they trigger; replaces the patterns loaded on the
                modulator.

        Yields:
            What was checked, the verdict, and what to do about it.

        Example:
            >>> with gs2ci.open_rig("rig.toml") as rig:
            ...     [finding.what for finding in rig.doctor(trigger_loop=False) if finding.verdict == "bad"]
            []
        """
        from gs2ci.rig.doctor import examine

        self.close()  # the check opens the ports itself, to find those that cannot be opened
        yield from examine(self._rig, trigger_loop=trigger_loop)

    def live(self, *, port: int = 8090, host: str = "127.0.0.1") -> LivePage:
        """Show the bench in a browser: the camera's picture, masks, focus, registration, stage, one exposure.

        Nothing is shown, exposed or moved before a button is pressed. The first page that connects controls the bench,
        others only watch; when that page closes, or the server stops, everything is disarmed.

        Args:
            port: Port of the local server; if it is in use, the next free one; 0 for any.
            host: Address to listen on: 127.0.0.1 is only this machine. Who has the secret of the printed address may
                connect, and take control if it is free.

        Returns:
            The page, with its `address`, which holds the secret; `stop()`, or the end of a `with` block, ends it.

        Raises:
            DeviceError: A device does not answer.
            InputError: No port is free.

        Example:
            >>> with gs2ci.open_rig("rig.toml") as rig, rig.live(port=0) as page:
            ...     page.address.startswith("http://127.0.0.1:")
            True
        """
        check_whole("--port", port, 0, 65_535, remedy="leave --port out, or give 0 for any that is free")
        self.close()  # the page opens the devices itself
        return LivePage(self._rig, host, port)

    def home(self) -> dict[str, float]:
        """Move the stage to its reference; the way must be free. Return the axes' positions, mm.

        Raises:
            DeviceError: The stage failed.
        """
        stage = self.devices.stage
        return {} if stage is None else dict(stage.home())

    def _calibrated(self, calibration: str | Path | None, probe: bool, progress: Progress) -> "Calibrated | None":
        from gs2ci.rig.calibrated import bundle_of, load

        # A file that cannot be used is told before any device is opened.
        bundle = bundle_of(self._rig, None if calibration is None else Path(calibration))
        return None if bundle is None else load(self._rig, self.devices, bundle, probe=probe, progress=progress)

    def _bench(self, display: "StageDisplay", *, fast: bool) -> "Bench":
        from gs2ci.rig.calibrating import bench_of, operator_of

        operator = operator_of(self._rig, display.ask)
        return bench_of(self._rig, self.devices, operator, fast=fast, progress=display)


def open_rig(path: str | Path) -> OpenRig:
    """Read a rig file; use the bench in a `with` statement, which closes its devices also after an error.

    Args:
        path: The rig file (TOML); docs/rigs has a simulated bench and a real one, with comments.

    Raises:
        InputError: The file cannot be read, or a value in it is invalid.

    Example:
        >>> with gs2ci.open_rig("rig.toml") as rig:
        ...     rig.plan(progress=gs2ci.Silent()).plan.broken
        ()
    """
    return OpenRig(path)


def find_devices() -> list[tuple[str, str, str]]:
    """Look for devices on this computer, without sending anything to them.

    Returns:
        Kind, port (as in a rig file) and name of each. The last ones have the kind "compute": what may render, with
        the name that `reconstruct` takes as its device, and what keeps it from being used.

    Example:
        >>> all(len(found) == 3 for found in gs2ci.find_devices())
        True
    """
    from gs2ci.render.devices import compute_devices
    from gs2ci.rig import discovery

    computing = [("compute", device, about) for device, about in compute_devices()]
    return [*discovery.find_devices(), *computing]


def _every_step(bench: "Bench") -> list[str]:
    """Return all steps in order, without `stage` if there is none and without `timing` if nothing is timed."""
    from gs2ci_calibration.procedures import PROCEDURES

    left_out = set()
    if bench.devices.stage is None:
        bench.progress.say("the rig has no stage: its step is left out")
        left_out.add("stage")
    if bench.gated:
        bench.progress.say("the sensor exposes while its line is held: the step `timing` is left out")
        left_out.add("timing")
    return [name for name in PROCEDURES if name not in left_out]
