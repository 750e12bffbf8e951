"""A finished reconstruction as an object: its arrays, its report, and methods to save and show it.

Here: `Run`, `open_run`. Not here: reconstructing (`reconstruction`), the folder's layout (`gs2ci.evaluate.run_folder`).
"""

import shutil
import tempfile
import webbrowser
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from numpy.typing import NDArray

from gs2ci.api.display import in_notebook
from gs2ci.api.options import as_path, check_whole
from gs2ci.core.arrays import F32, F64
from gs2ci.core.errors import InputError, StorageError
from gs2ci.core.findings import Code
from gs2ci.core.records import Shot

if TYPE_CHECKING:
    from gs2ci.core.run_records import RunResult
    from gs2ci.evaluate.report import Report
    from gs2ci.render.gaussians import Gaussians

FOLDER_REMEDY: Final = "give the folder that `gs2ci reconstruct` or `Run.save` wrote"
# A page in a notebook's cell: high enough for the first figures and one view.
_FRAME_PX: Final = 720


@dataclass(frozen=True, eq=False)
class Run:
    """Result of a reconstruction: views, camera path, scene, depth, and a report on their accuracy.

    Args:
        views: The recovered views, [N, H, W, C] float32, full scale 1, not clamped.
        path: Recovered poses, world to camera, [N, 4, 4], OpenCV axes.
        intrinsics: Camera matrix in pixels, [3, 3].
        distortion: Of the lens, [5] as in `Shot`; None for a pinhole.
        decode: The views as decoded without a scene, like `views`.
        scene_views: Renderings of the scene alone from the recovered cameras, like `views`.
        depth: Distance along the optical axis, [N, H, W], in the unit of the path, 0 where there is no surface; None
            if no depth was found.
        depth_spread: Spread of the absorption along the ray, as a share of depth, [N, H, W]; likewise.
        depth_confidence: Share of a pixel's light that is absorbed within 5 % of its depth, [N, H, W]; likewise.
        views_error: Standard error of the views' values, full scale 1, [N, H, W]; None in runs without standard errors.
        depth_error: Standard error of depth, in its unit, [N, H, W]; None likewise, without a path, or if things move.
            Those of poses are in `report.sureness`.
        folder: The run folder that it was read from or saved into; None if it is only in memory.
        result: The result of the pipeline; None for a run that was read from a folder.
        shot: The measurement; None for a run that was read from a folder.

    Example:
        >>> run = gs2ci.open_run("run")
        >>> run.views.shape, run.path.shape, len(run.scene) > 0
        ((4, 24, 32, 3), (4, 4, 4), True)
        >>> run.report.psnr_db.mean > 10
        True
    """

    views: F32
    path: F64
    intrinsics: F64
    distortion: F64 | None
    decode: F32
    scene_views: F32
    depth: F32 | None
    depth_spread: F32 | None
    depth_confidence: F32 | None
    views_error: F32 | None = None
    depth_error: F32 | None = None
    folder: Path | None = None
    result: "RunResult | None" = None
    shot: Shot | None = None
    _scene: "Gaussians | None" = field(default=None, repr=False)
    _unfinished: Path | None = field(default=None, repr=False)

    @classmethod
    def of(cls, shot: Shot, result: "RunResult", scene: "Gaussians", unfinished: Path | None = None) -> "Run":
        """Make a run from the result of the pipeline; `unfinished` is what is kept until it is saved."""
        return cls(
            views=result.views,
            path=result.world_to_camera,
            intrinsics=result.intrinsics,
            distortion=result.distortion,
            decode=result.decode,
            scene_views=result.scene_views,
            depth=result.depth,
            depth_spread=result.depth_spread,
            depth_confidence=result.depth_confidence,
            views_error=None if result.uncertainty is None else result.uncertainty.views,
            depth_error=None if result.uncertainty is None else result.uncertainty.depth,
            result=result,
            shot=shot,
            _scene=scene,
            _unfinished=unfinished,
        )

    @cached_property
    def scene(self) -> "Gaussians":
        """Get the Gaussians, as torch tensors on the CPU.

        Raises:
            InputError: The folder's scene.ply cannot be read.
        """
        if self._scene is not None:
            return self._scene
        from gs2ci.render.ply import read_ply

        assert self.folder is not None  # a run either has its scene in memory, or was read
        return read_ply(self.folder / "scene.ply")

    @cached_property
    def report(self) -> "Report":
        """Get every figure of the run: errors if the truth is known, residuals, times, notes and doubts.

        Raises:
            StorageError: The folder's report cannot be read.
        """
        if self.result is not None and self.shot is not None:
            from gs2ci.evaluate.run_report import build_report

            return build_report(self.shot, self.result)
        from gs2ci.evaluate.report import read_report

        assert self.folder is not None  # as above
        return read_report(self.folder)

    @property
    def interrupted(self) -> bool:
        """Get whether the reconstruction was interrupted, so that this is the best result by then.

        Raises:
            StorageError: The folder's report cannot be read.
        """
        return self.report.found(Code.INTERRUPTED) is not None

    def _repr_png_(self) -> bytes:
        """Show the decode's and the recovered middle view, and its depth."""
        from gs2ci.core.notebook import png_of, row_of
        from gs2ci.evaluate.pages.pictures import colour
        from gs2ci.evaluate.scales import inverse_depth_limits

        middle = len(self.views) // 2
        shown: list[Any] = [self.decode[middle], self.views[middle]]
        if self.depth is not None and (self.depth > 0).any():
            depth = self.depth[middle]
            inverse = np.divide(1, depth, out=np.zeros_like(depth), where=depth > 0)
            shown.append(
                colour(inverse, inverse_depth_limits(1 / self.depth[self.depth > 0]), "depth", empty=depth <= 0)
            )
        return png_of(row_of(shown))

    def _repr_html_(self) -> str:
        from gs2ci.core.notebook import card
        from gs2ci.evaluate.pages.next_steps import from_exposures
        from gs2ci.evaluate.summary import summary_rows

        facts = [(name, f"{value}  {remark}".rstrip()) for name, value, remark in summary_rows(self.report)]
        notes = [("" if k else "notes", note.advice) for k, note in enumerate(self.report.notes)]
        shown = "decode, recovered, depth (yellow is near)" if self.depth is not None else "decode, recovered"
        title = f"{self.report.name}: {self.report.views} views {from_exposures(self.report)}"
        return card(title, [*facts, *notes], self._repr_png_(), caption=f"middle view: {shown}")

    def save(self, folder: str | Path, *, overwrite: bool = False, moments: int | None = None) -> Path:
        """Write the run folder: report, page, views, depth, scene, cameras; whole or not at all.

        Args:
            folder: Where; parents are created.
            overwrite: Replace an earlier run at this place.
            moments: Also write this many pictures spread over the exposure, which show the scene alone; not possible
                for a run that was read from a folder.

        Returns:
            The folder, from which `open_run` reads it back.

        Raises:
            StorageError: Something else is there, or writing fails.
            InputError: That many moments cannot be rendered, the run was read from a folder, or the first argument is
                no path.
        """
        from gs2ci.evaluate.run_folder import write_run
        from gs2ci.evaluate.whole_folder import check_destination, whole_folder

        folder = as_path(folder, of="a folder", remedy="name the folder to write")
        if self.result is not None and self.shot is not None:
            write_run(folder, self.shot, self.result, self.scene, overwrite=overwrite, moments=moments)
            object.__setattr__(self, "folder", folder)
            if self._unfinished is not None:
                from gs2ci.reconstruct.exposures.unfinished import remove

                remove(self._unfinished)
            return folder
        if moments is not None:
            raise InputError("moments of a run that was read from a folder", remedy="reconstruct with --moments")
        assert self.folder is not None  # as above
        if folder.resolve() != self.folder.resolve():
            check_destination(folder, overwrite=overwrite)
            with whole_folder(folder, overwrite=overwrite) as partial:
                shutil.copytree(self.folder, partial, dirs_exist_ok=True)
        return folder

    def page(self, destination: str | Path | None = None) -> Path:
        """Build the run's page, one self-contained HTML file.

        Args:
            destination: The file, where only an earlier page is replaced; report.html in the run folder if None.

        Returns:
            The file.

        Raises:
            StorageError: The run was not saved and no destination is given, another file lies there, or the page
                cannot be written.
        """
        from gs2ci.evaluate.pages.run_page import write_run_page

        if self.folder is not None:
            return write_run_page(self.folder, None if destination is None else Path(destination))
        if destination is None:
            raise StorageError("the run has no folder yet", remedy="call save() first, or name a file for the page")
        with tempfile.TemporaryDirectory() as scratch:
            return write_run_page(self._written(Path(scratch)), Path(destination))

    def show(self) -> None:
        """Show the run's page: in a notebook below its cell, elsewhere in the browser.

        Raises:
            StorageError: The run folder is damaged.
        """
        if in_notebook():
            from IPython.display import HTML, display

            display(HTML(self._framed_page()))  # type: ignore[no-untyped-call]
            return
        if self.folder is not None:
            open_page(self.page())
            return
        # The browser reads the file after this call: it stays until the system clears its temporary files.
        open_page(self.page(Path(tempfile.mkdtemp(prefix="gs2ci-")) / "report.html"))

    def view(self, *, port: int = 8080, host: str = "127.0.0.1") -> Any:
        """Serve scene and cameras to a browser; needs the extra `view`.

        Args:
            port: Port of the local server; if it is in use, the next free one; 0 for any.
            host: Address to listen on: 127.0.0.1 is only this machine, 0.0.0.0 everybody who reaches it. Who has the
                secret of the printed address may connect.

        Returns:
            What serves it, with its `address`, which holds the secret; `stop()` ends it.

        Raises:
            InputError: viser is not installed, or no port is free.
            StorageError: The run was not saved, or its folder is damaged.
        """
        check_whole("--port", port, 0, 65_535, remedy="leave --port out, or give 0 for any that is free")
        from gs2ci.evaluate import viewer

        if self.folder is None:
            raise StorageError("the run has no folder yet", remedy="call save() first")
        return viewer.serve(viewer.load_scene(self.folder), host=host, port=port)

    def _written(self, scratch: Path) -> Path:
        """Return the run's folder, or a temporary one."""
        from gs2ci.evaluate.run_folder import write_run

        if self.folder is not None:
            return self.folder
        assert self.result is not None and self.shot is not None  # noqa: PT018  in memory alone
        return write_run(scratch / "run", self.shot, self.result, self.scene)

    def _framed_page(self) -> str:
        """Return the page inside an iframe, so that its policy and style do not mix with the notebook's."""
        from markupsafe import escape

        with tempfile.TemporaryDirectory() as scratch:
            text = self.page(Path(scratch) / "report.html").read_text(encoding="utf-8")
        return f'<iframe srcdoc="{escape(text)}" style="width:100%;height:{_FRAME_PX}px;border:0"></iframe>'


def open_run(folder: str | Path) -> Run:
    """Read a run folder back.

    Args:
        folder: As `gs2ci reconstruct` or `Run.save` wrote it.

    Raises:
        StorageError: It is no run folder, or a part of it is missing or damaged.
        InputError: The argument is no path.

    Example:
        >>> gs2ci.open_run("run").report.name
        'measurement'
    """
    from gs2ci.evaluate.pages.run_evidence import read_run

    folder = as_path(folder, of="a run folder", remedy=FOLDER_REMEDY)
    found = read_run(folder)
    channels = found.report.channels  # a mono run's files hold three equal ones

    def copied(values: NDArray[Any] | None) -> F32 | None:
        return None if values is None else np.array(values)

    return Run(
        views=np.array(found.views[..., :channels]),
        path=found.world_to_camera,
        intrinsics=found.intrinsics,
        distortion=found.distortion,
        decode=np.array(found.decode[..., :channels]),
        scene_views=np.array(found.scene_views[..., :channels]),
        depth=copied(found.depth),
        depth_spread=copied(found.depth_spread),
        depth_confidence=copied(found.depth_confidence),
        views_error=copied(found.views_error),
        depth_error=copied(found.depth_error),
        folder=folder,
    )


def open_page(page: Path) -> bool:
    """Open a page in the user's browser; return whether there is one."""
    return webbrowser.open(page.resolve().as_uri())
