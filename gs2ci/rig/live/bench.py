"""The bench behind the live page: one thread owns its devices, answers requests, and takes pictures.

A mask is shown by a sequence that ends by itself after `HOLD_S` and is restarted as long as a page is open: even if the
whole process is killed, a modulator with a clock of its own goes dark. Where the host steps the masks, each is one
sequence: nobody would step to the next one in time while a picture is awaited.

Here: `LiveBench`. Not here: the page and who may press its buttons (`server`), the figures of a picture (`looks`).
"""

import math
import tempfile
import threading
import time
from collections import deque
from collections.abc import Callable
from concurrent.futures import Future
from contextlib import ExitStack, suppress
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from queue import Empty, SimpleQueue
from typing import Any, Final

import numpy as np

from gs2ci.core.arrays import F64, U16
from gs2ci.core.clock import Clock
from gs2ci.core.errors import DeviceError, Gs2ciError, InputError
from gs2ci.core.extras import missing_extra
from gs2ci.core.progress import Silent
from gs2ci.core.storage import read_shot
from gs2ci.rig.calibrated import Calibrated, bundle_of, load
from gs2ci.rig.intent import intended
from gs2ci.rig.live.looks import encode_png, figures_of, picture_png, residual_of
from gs2ci.rig.opening import Rig
from gs2ci.rig.patterns import on_modulator
from gs2ci.rig.recording import prepare, record, saturation_of
from gs2ci_drivers.acquisition import Devices
from gs2ci_drivers.failures import DriverError, FrameError, FrameLostError, OutOfRangeError
from gs2ci_drivers.pattern_sequence import PatternSequence, TriggerOut
from gs2ci_drivers.sensor import SensorConfig, TriggerMode

HOLD_S: Final = 20.0
"""How long a mask is shown without a new request."""
RENEWED_S: Final = 15.0
STEP_S: Final = 0.5
"""How long each mask of a sequence is shown, for a person to see it."""
READ_S: Final = 1.0
"""How long a picture is waited for beyond its exposure."""
PICTURES_PER_S: Final = 15.0
MOVE_LOOK_S: Final = 0.05
"""How often a moving stage is asked whether it rests, and whether it or an exposure is to stop."""
LARGEST_JOG_MM: Final = 10.0
DECODE_ITERATIONS: Final = 20
FIRST_EXPOSURE_S: Final = 0.01
KEPT_NOTES: Final = 8


@dataclass
class LiveView:
    """The data that the page shows; callers get a copy.

    Args:
        picture: The camera's latest picture, PNG.
        number: Number of that picture, increasing.
        size: Its rows and columns before it was reduced for the page.
        views: Decoded views of the latest exposure, PNG.
        state: Everything else, for JSON.
    """

    picture: bytes = b""
    number: int = 0
    size: tuple[int, int] = (0, 0)
    views: tuple[bytes, ...] = ()
    state: dict[str, Any] = field(default_factory=dict)


class _End:
    """Ends an exposure, once, where one is being taken and its end is requested.

    Args:
        asked: Tells whether it is.
    """

    def __init__(self, asked: Callable[[], bool]) -> None:
        self._asked = asked
        self.taking = False

    def if_asked(self) -> None:
        """Raise a DeviceError if the end is requested; what brings the devices to rest afterwards is not ended."""
        if self.taking and self._asked():
            self.taking = False
            raise DeviceError(
                "the exposure was ended: a request to disarm came", remedy="press the button again to take another"
            )


class _Interruptible(Silent):
    """Ends a capture at its next report, if that is requested."""

    def __init__(self, end: _End) -> None:
        super().__init__()
        self._end = end

    def stage(self, name: str, total: int | None = None) -> None:
        """Raise a DeviceError if the end is requested."""
        self._end.if_asked()

    def step(self, done: int, **figures: float | int | str) -> None:
        """Raise a DeviceError if the end is requested."""
        self._end.if_asked()


class _EndingClock:
    """A clock of modulator and stage between their commands: an exposure ends where they look at it, if requested.

    Their links keep the rig's own clock, so that no command is left without its answer.
    """

    def __init__(self, clock: Clock, end: _End) -> None:
        self._clock = clock
        self._end = end

    def now_s(self) -> float:
        """Get the time in seconds; raise a DeviceError if the end is requested."""
        self._end.if_asked()
        return self._clock.now_s()

    def sleep_s(self, duration_s: float) -> None:
        """Let time pass; raise a DeviceError if the end is requested meanwhile."""
        until_s = self.now_s() + duration_s
        while self._end.taking and duration_s > MOVE_LOOK_S:
            self._clock.sleep_s(MOVE_LOOK_S)
            duration_s = until_s - self.now_s()
        self._clock.sleep_s(duration_s)


class LiveBench:
    """A bench and its thread, the only one that uses its devices.

    Args:
        rig: The rig; its devices are opened by `begin`.
    """

    def __init__(self, rig: Rig) -> None:
        self._rig = rig
        self._asked: SimpleQueue[tuple[Callable[[], None], Future[None]]] = SimpleQueue()
        self._ended = threading.Event()
        self._disarm_waits = threading.Event()  # set while a request to disarm waits
        self._end = _End(self._asked_to_stop)
        self._lock = threading.Lock()
        self._view = LiveView()
        self._notes: list[str] = []
        self._thread: threading.Thread | None = None
        self._devices: Devices
        self._config: SensorConfig
        self._codes: U16
        self._calibrated: Calibrated | None = None
        self._exposure_s = FIRST_EXPOSURE_S
        self._camera_on = False
        self._moving = False
        self._taking = False
        self._shown = "dark"
        self._mask: int | None = None
        self._turn: deque[PatternSequence] = deque()  # shown one after another, the present one first
        self._shown_since_s = 0.0
        self._figures: dict[str, Any] = {}
        self._residual: dict[str, Any] | None = None
        self._taken: dict[str, Any] | None = None

    @property
    def armed(self) -> list[str]:
        """Get which devices are active: showing, streaming or moving."""
        return [
            *([f"the modulator shows {self._shown}"] if self._turn else []),
            *(["the camera streams"] if self._camera_on else []),
            *(["the stage moves"] if self._moving else []),
            *(["one exposure is taken"] if self._taking else []),
        ]

    def view(self) -> LiveView:
        """Return the present data for the page."""
        with self._lock:
            return replace(self._view, state=dict(self._view.state))

    def begin(self) -> None:
        """Open and connect the devices and start the thread; nothing is shown, exposed or moved.

        Raises:
            DriverError: A device does not answer.
            InputError: The masks do not fit on the modulator.
        """
        devices = self._rig.open()
        clock = _EndingClock(devices.clock, self._end)
        for device in (devices.modulator, devices.stage):
            if device is not None:
                device.clock = clock
        self._devices = replace(devices, clock=clock)
        try:
            self._codes, _, self._config = intended(self._rig, self._devices)
            if self._devices.stage is not None:
                self._devices.stage.connect()
            try:
                bundle = bundle_of(self._rig, None)
                calibrated = None if bundle is None else load(self._rig, self._devices, bundle, probe=False)
                self._calibrated = calibrated
            except Gs2ciError as error:
                self._note(f"the masks as drawn are used: {error}")
            info = self._devices.sensor.info
            self._exposure_s = min(max(FIRST_EXPOSURE_S, info.min_exposure_s), info.max_exposure_s)
            self._publish()
        except BaseException:
            self._devices.close()
            raise
        self._thread = threading.Thread(target=self._serve, name="live bench", daemon=True)
        self._thread.start()

    def close(self) -> None:
        """Disarm everything and release the devices; may be called twice."""
        self._ended.set()
        if self._thread is not None:
            self._thread.join()
            self._thread = None

    def act(self, action: str, **given: Any) -> None:
        """Carry out a button's action, and wait until it is done.

        Args:
            action: "camera", "show", "exposure", "jog", "take" or "disarm".
            **given: Its arguments; see the methods of those names.

        Raises:
            InputError: No such action, or its arguments are invalid.
            DriverError: A device failed; everything is disarmed.
        """
        known: dict[str, Callable[..., None]] = {
            "camera": self._camera,
            "show": self._show,
            "exposure": self._exposure,
            "jog": self._jog,
            "take": self._take,
            "disarm": self._disarm_all,
        }
        if action not in known:
            raise InputError(f"action {action!r}", allowed=", ".join(known))
        done: Future[None] = Future()

        def do() -> None:
            try:
                known[action](**given)
            except (TypeError, ValueError, OverflowError) as error:  # no such argument, or no number
                raise InputError(f"{action} with {given}", allowed=str(error)) from error

        with self._lock:  # what is asked before the end is refused there, and nothing is asked after it
            if self._ended.is_set() or self._thread is None:
                raise InputError("the bench is closed", remedy="start `gs2ci live` again")
            self._asked.put((do, done))
            if action == "disarm":
                self._disarm_waits.set()
        done.result()

    def _serve(self) -> None:
        """Serve requests and take pictures until `close`; then disarm."""
        try:
            while not self._ended.is_set():
                began_s = time.monotonic()
                self._answer(wait_s=0.0 if self._camera_on else 0.05)
                try:
                    self._renew()
                    self._look()
                except FrameError as error:
                    self._note(str(error))
                except DriverError as error:
                    self._note(str(error))
                    self._disarm()
                self._publish()
                self._ended.wait(max(0.0, began_s + 1 / PICTURES_PER_S - time.monotonic()) if self._camera_on else 0.0)
        except Exception as error:
            self._note(f"the bench has ended: {str(error) or type(error).__name__}")
            raise
        finally:
            self._ended.set()
            with ExitStack() as ending:  # each is done, even if another one fails
                for step in (self._refuse_the_rest, self._devices.close, self._publish, self._disarm):
                    ending.callback(step)

    def _answer(self, wait_s: float) -> None:
        try:
            action, done = self._asked.get(timeout=wait_s) if wait_s else self._asked.get_nowait()
        except Empty:
            return
        try:
            action()
        except Exception as error:
            self._note(str(error) or type(error).__name__)
            if not isinstance(error, InputError | OutOfRangeError):  # these are refused before anything changes
                self._disarm()
            self._publish()
            done.set_exception(error)
        else:
            self._publish()
            done.set_result(None)

    def _refuse_the_rest(self) -> None:
        with self._lock, suppress(Empty):
            while True:
                _, done = self._asked.get_nowait()
                done.set_exception(InputError("the bench is closed", remedy="start `gs2ci live` again"))

    def _camera(self, *, on: bool) -> None:
        """Let the camera run by its own clock, or stop it."""
        if not on:
            self._camera_on = False
            self._devices.sensor.stop()
            return
        self._devices.sensor.stop()
        self._devices.sensor.configure(replace(self._config, exposure_s=self._exposure_s, trigger=TriggerMode.FREE_RUN))
        self._camera_on = True  # set before the start: a start that fails half-way needs stopping too
        self._devices.sensor.start()

    def _exposure(self, *, seconds: float) -> None:
        """Set the exposure time from the next picture on."""
        info = self._devices.sensor.info
        if math.isinf(float(seconds)) or not info.min_exposure_s <= float(seconds) <= info.max_exposure_s:
            raise InputError(
                f"an exposure of {seconds} s", allowed=f"{info.min_exposure_s:g} to {info.max_exposure_s:g} s"
            )
        self._exposure_s = float(seconds)
        if self._camera_on:
            self._camera(on=True)

    def _show(self, *, what: str, index: int = 0) -> None:
        """Show one mask ("mask", `index` from 0), all of them in turn, everything open, or nothing."""
        modulator = self._devices.modulator
        if what not in ("dark", "open", "mask", "sequence"):
            raise InputError(f"show {what!r}", allowed="dark, open, mask, sequence")
        if what == "mask" and index not in range(len(self._codes)):
            raise InputError(f"mask {index + 1:g}", allowed=f"1 to {len(self._codes)}, as the page counts them")
        modulator.disarm()
        self._turn.clear()
        self._shown, self._mask, self._residual = "dark", None, None
        if what == "dark":
            return
        bits = self._rig.table.capture.bit_depth
        size = (modulator.info.height, modulator.info.width)
        if what == "open":
            levels = np.full((1, *size), 2**bits - 1, np.uint16 if bits > 8 else np.uint8)
        else:
            chosen = self._codes if what == "sequence" else self._codes[int(index)][None]
            levels = on_modulator(chosen, self._rig.table.registration, size)
        timed, outs = modulator.info.hardware_timed, modulator.info.trigger_outs
        step_s = min(STEP_S if timed else HOLD_S, modulator.info.max_exposure_s)
        sequences = deque(
            PatternSequence(
                shown,
                bits,
                step_s,
                repeats=max(1, round(HOLD_S / (step_s * len(shown)))),
                trigger=TriggerOut.NONE if TriggerOut.NONE in outs else sorted(outs, key=lambda out: out.value)[0],
            )
            for shown in ([levels] if timed else np.split(levels, len(levels)))
        )
        modulator.upload(sequences[0])
        self._turn = sequences
        self._shown = {"open": "everything open", "sequence": "all masks in turn"}.get(what, f"mask {int(index) + 1}")
        self._mask = int(index) if what == "mask" else None
        self._start()

    def _start(self) -> None:
        self._devices.modulator.arm()
        self._devices.modulator.start()
        self._shown_since_s = self._devices.clock.now_s()

    def _renew(self) -> None:
        """Restart a sequence before it ends by itself, or go on to the next one if there are several."""
        if not self._turn:
            return
        modulator, now_s = self._devices.modulator, self._devices.clock.now_s()
        several = len(self._turn) > 1
        if not self._camera_on and self._rig.bench is not None:
            self._devices.clock.sleep_s(1 / PICTURES_PER_S)  # simulated time passes only while something waits
        if now_s - self._shown_since_s > (STEP_S if several else RENEWED_S):
            self._turn.rotate(-1)
            modulator.disarm()
            if several or modulator.loaded is None:
                modulator.upload(self._turn[0])
            self._start()

    def _jog(self, *, axis: str, mm: float) -> None:
        """Move an axis by a distance, within its limits, and wait until it rests; a request to disarm stops it."""
        stage = self._devices.stage
        if stage is None:
            raise InputError("this rig has no stage", remedy="add a [stage] to the rig file")
        if axis not in stage.info.axes or not abs(float(mm)) <= LARGEST_JOG_MM:
            raise InputError(
                f"jog {axis!r} by {mm} mm", allowed=f"{', '.join(stage.info.axes)} by at most {LARGEST_JOG_MM:g} mm"
            )
        target_mm = {axis: stage.positions_mm()[axis] + float(mm)}
        clock = self._devices.clock
        until_s = clock.now_s() + stage.move_timeout_s(target_mm)
        stage.begin_move(target_mm)
        self._moving = True
        try:
            while stage.status().moving and clock.now_s() < until_s:
                if self._asked_to_stop():
                    stage.stop()
                    return
                self._publish()
                clock.sleep_s(MOVE_LOOK_S)
            stage.wait_idle(MOVE_LOOK_S)
        finally:
            self._moving = False

    def _asked_to_stop(self) -> bool:
        """Tell whether a request to disarm or to close waits."""
        return self._disarm_waits.is_set() or self._ended.is_set()

    def _take(self) -> None:
        """Take one coded exposure by the rig file and decode it; afterwards camera and modulator are off.

        A request to disarm ends it during the upload of the masks, and wherever modulator or stage is waited for.

        Raises:
            DeviceError: It was ended.
        """
        try:  # a bench's computer may lack the modules that decode
            from gs2ci.reconstruct.decode.gap_tv import GapTvSettings, gap_tv  # noqa: PLC0415
            from gs2ci.reconstruct.registration.register import register  # noqa: PLC0415
        except ModuleNotFoundError as error:
            raise missing_extra(error) or error from error
        self._disarm()
        table = self._rig.table
        capture = table.capture.model_copy(update={"shots": 1, "burst": 1, "continuous": False})
        rig = replace(self._rig, table=table.model_copy(update={"capture": capture}))
        self._taking = self._end.taking = True
        self._publish()
        try:
            with tempfile.TemporaryDirectory(prefix="gs2ci-live-") as folder:
                out = Path(folder) / "shot.h5"
                began_s = time.monotonic()
                prepared = prepare(rig, self._devices, self._calibrated)
                record(rig, self._devices, prepared, out, replace=True, progress=_Interruptible(self._end))
                took_s = time.monotonic() - began_s
                shot = read_shot(out, 0)
            registered = register(shot)
            for note in registered.notes:
                self._note(note.advice)
            views = gap_tv(registered.shot, GapTvSettings(iterations=DECODE_ITERATIONS))
        finally:
            self._taking = self._end.taking = False
        drawn = np.rint(255 * np.sqrt(views)).astype(np.uint8)
        pictures = tuple(encode_png(view[:, :, 0] if view.shape[2] == 1 else view) for view in drawn)
        with self._lock:
            self._view.views = pictures
        self._taken = {
            "views": len(pictures),
            "number": (self._taken or {"number": 0})["number"] + 1,
            "exposure_s": prepared.plan.exposure_s,
            "seconds": took_s,
        }

    def _disarm_all(self) -> None:
        """Stop all devices, as requested."""
        self._disarm_waits.clear()
        self._disarm()

    def _disarm(self) -> None:
        """Stop all devices in any state, even if one of them raises an error."""
        steps: list[Callable[[], object]] = [self._devices.modulator.disarm, self._devices.sensor.stop]
        if self._devices.stage is not None:
            steps.append(self._devices.stage.stop)
        for step in steps:
            try:
                step()
            except Gs2ciError as error:
                self._note(str(error))
        self._turn.clear()
        self._shown, self._mask, self._residual = "dark", None, None
        self._camera_on = self._moving = False

    def _look(self) -> None:
        """Take the camera's next picture."""
        if not self._camera_on:
            return
        sensor, black_dn = self._devices.sensor, self._rig.table.sensor.black_level_dn
        wait_s = self._exposure_s + sensor.settings.readout_s + READ_S
        sensor.discard()  # so that the picture is taken with the present settings
        try:
            pixels = sensor.read(wait_s).pixels
        except FrameLostError:  # nobody reads between two pictures; the frame after the gap comes with the next call
            pixels = sensor.read(wait_s).pixels
        top = sensor.settings.format.top
        saturation_dn = saturation_of(self._rig.table, top)
        self._figures = asdict(figures_of(pixels, top, saturation_dn, black_dn)) | {"top_dn": top}
        mask = self._mask_at_the_sensor()
        self._residual = None if mask is None else asdict(residual_of(pixels, mask, black_dn))
        picture, size = picture_png(pixels, top, saturation_dn, black_dn)
        with self._lock:
            self._view.picture, self._view.size = picture, size
            self._view.number += 1

    def _mask_at_the_sensor(self) -> F64 | None:
        if self._mask is None:
            return None
        masks = self._codes if self._calibrated is None else self._calibrated.masks
        return np.asarray(masks[self._mask], np.float64)

    def _note(self, text: str) -> None:
        self._notes = [*self._notes, text][-KEPT_NOTES:]

    def _publish(self) -> None:
        """Publish the present data for the other threads."""
        info = self._devices.sensor.info
        stage = self._devices.stage
        positions: dict[str, Any] = {}
        if stage is not None and not self._ended.is_set():
            with suppress(DriverError):
                here = stage.positions_mm()
                positions = {
                    name: {"mm": here.get(name), "min_mm": axis.min_mm, "max_mm": axis.max_mm}
                    for name, axis in stage.info.axes.items()
                }
        state = {
            "name": self._rig.table.name,
            "kind": "simulated" if self._rig.bench else "real",
            "armed": self.armed,
            "camera": self._camera_on,
            "shown": self._shown,
            "masks": len(self._codes),
            "exposure_s": self._exposure_s,
            # Without an exposure control there is no longest exposure, and JSON has no infinity.
            "exposure_limits_s": [
                limit_s if math.isfinite(limit_s) else None for limit_s in (info.min_exposure_s, info.max_exposure_s)
            ],
            "axes": positions,
            "figures": self._figures,
            "residual": self._residual,
            "taken": self._taken,
            "taking": self._taking,
            "notes": list(self._notes),
        }
        with self._lock:
            self._view.state = state
