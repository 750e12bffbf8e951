"""What other people's newest programs make of a run's exports: `python -m tests.clients RUN`, a table of figures.

Not part of the tests: it installs the newest releases by npm and pip into a temporary folder, and what they do changes
without us. Each row has a figure and a limit; a row beyond its limit makes the exit status 1, a program that cannot be
had here is said to be absent. `-o FILE` writes the table as a page (docs/clients.md).
"""

import argparse
import json
import re
import shutil
import subprocess
import sys
import tempfile
import venv
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np
import torch
import trimesh

import gs2ci
from gs2ci.api.runs import Run
from gs2ci.core.colmap import pycolmap
from gs2ci.evaluate.pages.run_page import write_run_page
from gs2ci.render.backend import load_backend
from gs2ci.render.gaussians import Gaussians
from gs2ci.render.half_turn import half_turned
from gs2ci.render.harmonics import SH_DC
from gs2ci.render.ply import read_ply
from tests.clients.spark import browser, drawn
from tests.render.scenes_in_units import psnr_db, scaled

NPM = (
    "@playcanvas/splat-transform",
    "@sparkjsdev/spark",
    "three",
    "axe-core",
    "gltf-validator",
    "@adobe/spz",
    "@babylonjs/core",
)
SPARK_DB, ROUND_TRIP_DB, LOADED_DB = 33.0, 45.0, 40.0
PATIENCE_S = 900


@dataclass(frozen=True)
class Row:
    """One figure: of which program and file, its limit, and whether it is met; None where there is none."""

    client: str
    file: str
    figure: str
    limit: str = ""
    met: bool | None = None


class AbsentError(Exception):
    """A program cannot be had on this machine."""


@dataclass(frozen=True)
class Bench:
    """The run, its exports and where npm's packages are."""

    run: Run
    work: Path
    node: Path

    def export(self, to: str, name: str, **options: Any) -> Path:
        """Export once, and find the same file again."""
        path = self.work / name
        if path.exists():
            return path
        if to in ("spz", "sog", "glb"):  # fitted to viewers once, for the PLY file
            fitted = replace(self.run, _scene=read_ply(self.export("ply", "scene.ply")))
            return gs2ci.export(fitted, to, path, as_fitted=True, **options)
        return gs2ci.export(self.run, to, path, **options)

    def command(self, *words: str | Path) -> str:
        """Run a program and return what it says.

        Raises:
            AbsentError: There is none of that name.
        """
        if shutil.which(str(words[0])) is None:
            raise AbsentError(f"no {words[0]} on this machine")
        done = subprocess.run(list(map(str, words)), capture_output=True, text=True, timeout=PATIENCE_S, check=True)
        return done.stdout + done.stderr

    def version(self, package: str) -> str:
        """Return which release npm has installed."""
        told = json.loads((self.node / "node_modules" / package / "package.json").read_text())
        return f"{package} {told['version']}"

    def spz_scale(self) -> float:
        """Export as SPZ, and return by how much its lengths are said to differ from the run's."""
        heard = gs2ci.Silent()
        (self.work / "scene.spz").unlink(missing_ok=True)
        self.export("spz", "scene.spz", progress=heard)
        told = re.search(r"are (\S+) times those of the run", " ".join(heard.sentences))
        return float(told[1]) if told else 1.0

    def shown(self, scene: Gaussians) -> np.ndarray:
        """Render the run's views of a scene by our own renderer."""
        height, width = self.run.views.shape[1:3]
        path, intrinsics = torch.from_numpy(self.run.path).float(), torch.from_numpy(self.run.intrinsics).float()
        with torch.no_grad():
            images, _ = load_backend().views(scene, path, intrinsics, (int(height), int(width)))
        return images.clamp(0, 1).numpy()

    @property
    def distance(self) -> float:
        """Get the median depth before the middle camera."""
        pose = self.run.path[len(self.run.path) // 2]
        ahead = self.run.scene.means.double().numpy() @ pose[2, :3] + pose[2, 3]
        return float(np.median(ahead[ahead > 0]))


def _db(client: str, file: str, found: float, least: float) -> Row:
    return Row(client, file, f"{found:.2f} dB", f">= {least:g} dB", found >= least)


def splat_transform(bench: Bench) -> Iterator[Row]:
    """Read every file of Gaussians by splat-transform, and compare what it writes as PLY with our PLY."""
    client = bench.version("@playcanvas/splat-transform")
    program = bench.node / "node_modules/@playcanvas/splat-transform/bin/cli.mjs"
    wanted = bench.shown(read_ply(bench.export("ply", "scene.ply")))
    scale = bench.spz_scale()
    files = (
        ("ply", "scene.ply", {}),
        ("sog", "scene.sog", {}),
        ("spz", "scene.spz", {}),
        ("spz", "two.spz", {"spz_version": 2}),
    )
    for to, name, options in files:
        back = bench.work / f"back-{name}.ply"
        bench.command("node", program, "-q", "-w", bench.export(to, name, **options), back)
        read, what = read_ply(back), "rendered as the PLY file is"
        if to == "spz":  # its numbers as they are, y up, since version 3 (findings/splat-transform-3-spz-axes.sh)
            read, what = half_turned(scaled(read, 1 / scale)), f"turned from y up, {what}"
        yield _db(client, f"{name}, {what}", psnr_db(bench.shown(read), wanted), ROUND_TRIP_DB)


READERS = {
    "open3d": "import open3d, sys; files = open3d.t.io; "
    "files.write_point_cloud(sys.argv[2], files.read_point_cloud(sys.argv[1]))",
    "gsply": "import gsply, sys; read = gsply.read_spz if sys.argv[1].endswith('spz') else gsply.plyread; "
    "gsply.plywrite(sys.argv[2], read(sys.argv[1]))",
}
"""Libraries of Python that read Gaussians, and what each runs to write a file as PLY."""


def libraries(bench: Bench) -> Iterator[Row]:
    """Read files of Gaussians by libraries of Python, and compare what they write as PLY with our PLY."""
    wanted, scale = bench.shown(read_ply(bench.export("ply", "scene.ply"))), bench.spz_scale()
    place = bench.work / "libraries"
    venv.create(place, with_pip=True)
    for name, script in READERS.items():
        bench.command(place / "bin/pip", "install", "--quiet", name)
        client = f"{name} {bench.command(place / 'bin/pip', 'show', name).partition('Version: ')[2].split()[0]}"
        for to in ("ply", "spz"):
            back = bench.work / f"back-{name}-{to}.ply"
            bench.command(place / "bin/python", "-c", script, bench.export(to, f"scene.{to}"), back)
            # Both hand out the numbers of SPZ as they are, y up, also into a PLY file.
            read = read_ply(back) if to == "ply" else half_turned(scaled(read_ply(back), 1 / scale))
            what = "rendered as the PLY file is" if to == "ply" else "turned from y up, rendered as the PLY file is"
            yield _db(client, f"scene.{to}, {what}", psnr_db(bench.shown(read), wanted), ROUND_TRIP_DB)


LOADERS = {
    "@adobe/spz": (
        "spz",
        """import load from '@adobe/spz'
const spz = await load(), cloud = spz.loadSpzFromBuffer(bytes, { to: spz.CoordinateSystem.RDF })
const read = { means: cloud.positions, log_scales: cloud.scales, xyzw: cloud.rotations,
  opacity: cloud.alphas.map((logit) => 1 / (1 + Math.exp(-logit))),
  colours: cloud.colors.map((dc) => 0.5 + DC * dc) }""",
    ),
    "@babylonjs/core": (
        "ply",
        """import { GaussianSplattingMesh } from '@babylonjs/core/Meshes/GaussianSplatting/gaussianSplattingMesh.js'
const { buffer } = await GaussianSplattingMesh.ConvertPLYWithSHToSplatAsync(bytes.buffer)
const floats = new Float32Array(buffer), octets = new Uint8Array(buffer), count = floats.length / 8
const rows = (width, value) =>
  Float32Array.from({ length: count * width }, (_, i) => value(Math.floor(i / width), i % width))
const read = { means: rows(3, (row, k) => floats[8 * row + k]),
  log_scales: rows(3, (row, k) => Math.log(floats[8 * row + 3 + k])),
  xyzw: rows(4, (row, k) => octets[32 * row + 28 + ((k + 1) % 4)] - 128),
  opacity: rows(1, (row) => octets[32 * row + 27] / 255),
  colours: rows(3, (row, k) => octets[32 * row + 24 + k] / 255) }""",
    ),
}
"""Packages of npm that read Gaussians: which file, and a module that makes `read` of its `bytes`."""


def loaders(bench: Bench) -> Iterator[Row]:
    """Read files of Gaussians by the loaders of viewers, and compare the numbers with our PLY."""
    ours = read_ply(bench.export("ply", "scene.ply"))
    wanted, scale = bench.shown(replace(ours, harmonics=None)), bench.spz_scale()
    for package, (to, module) in LOADERS.items():
        script, numbers = bench.node / f"read-{to}.mjs", bench.work / f"read-{to}.json"
        imported, _, body = module.partition("\n")
        script.write_text(
            f"import {{ readFileSync, writeFileSync }} from 'node:fs'\n{imported}\nconst DC = {SH_DC}\n"
            f"const bytes = Uint8Array.from(readFileSync(process.argv[2]))\n{body}\n"
            "for (const key in read) read[key] = Array.from(read[key])\n"
            "writeFileSync(process.argv[3], JSON.stringify(read))\n"
        )
        bench.command("node", script, bench.export(to, f"scene.{to}"), numbers)
        found = {
            key: torch.tensor(values).reshape(len(ours), -1) for key, values in json.loads(numbers.read_text()).items()
        }
        opacity = found["opacity"][:, 0].clamp(1e-6, 1 - 1e-6)
        scene = Gaussians(
            found["means"], found["log_scales"], found["xyzw"][:, [3, 0, 1, 2]], torch.logit(opacity), found["colours"]
        )
        shown = bench.shown(scaled(scene, 1 / (scale if to == "spz" else 1)))
        yield _db(bench.version(package), f"scene.{to}, without harmonics", psnr_db(shown, wanted), LOADED_DB)


def spark(bench: Bench) -> Iterator[Row]:
    """Draw every file in Spark with its defaults, against what the run's scene shows."""
    client = f"{bench.version('@sparkjsdev/spark')} in Chromium"
    wanted = np.clip(bench.run.scene_views, 0, 1)
    scale = bench.spz_scale()
    turn = np.diag([1.0, -1, -1, 1])
    kinds = [("ply", "scene.ply", np.eye(4)), ("spz", "scene.spz", turn @ np.diag([scale, scale, scale, 1]))]
    for to, name, axes in [*kinds, ("sog", "scene.sog", np.eye(4))]:
        size = (int(wanted.shape[1]), int(wanted.shape[2]))
        file = bench.export(to, name)
        distance = bench.distance * float(np.cbrt(abs(np.linalg.det(axes[:3, :3]))))
        seen = drawn(bench.node, file, bench.run.path, bench.run.intrinsics, size, distance, axes=axes)
        yield _db(client, f"{name}, against scene_views", psnr_db(seen, wanted), SPARK_DB)


def gltf_validator(bench: Bench) -> Iterator[Row]:
    """Ask Khronos's validator, which knows no splats: of the file around them."""
    script = "const v=require('gltf-validator'),f=require('fs');v.validateBytes(new Uint8Array(f.readFileSync("
    script += f"{str(bench.export('glb', 'scene.glb'))!r}))).then(r=>console.log(JSON.stringify(r.issues)))"
    done = subprocess.run(
        ["node", "-e", script], cwd=bench.node, capture_output=True, text=True, timeout=PATIENCE_S, check=True
    )
    found = json.loads(done.stdout)
    # It has an error for each attribute that the extension asks for (findings/gltf-validator-splats.sh).
    own = [one for one in found["messages"] if ":" not in one["pointer"].rpartition("/")[2] and one["severity"] == 0]
    figure = f"{len(own)} errors beside the extension's attributes, {found['numWarnings']} warnings"
    yield Row(bench.version("gltf-validator"), "scene.glb", figure, "0 errors", not own)


def colmap(bench: Bench) -> Iterator[Row]:
    """Count what pycolmap, and Debian's COLMAP, find in the model."""
    folder = bench.export("colmap", "colmap") / "sparse" / "0"
    model = pycolmap.Reconstruction(str(folder))
    seen, errors = model.compute_num_observations(), []
    for image in model.images.values():
        for observed in image.points2D:
            point = model.points3D[observed.point3D_id]
            errors.append(np.linalg.norm(image.project_point(point.xyz) - observed.xy))
    client, worst = f"pycolmap {pycolmap.__version__}", max(errors, default=np.inf)
    yield Row(client, "colmap/", f"{seen} observations", "> 0", seen > 0)
    yield Row(client, "colmap/, largest distance of an observation", f"{worst:.2g} px", "< 0.001 px", worst < 1e-3)
    told = bench.command("colmap", "model_analyzer", "--path", folder)
    found = re.findall(r"(?:Observations|Mean track length): ([\d.]+)", told)
    yield Row("COLMAP", "colmap/, observations and mean length of tracks", ", ".join(found), "> 0", float(found[0]) > 0)


def mesh(bench: Bench) -> Iterator[Row]:
    """Count a mesh's pieces by trimesh."""
    path = bench.work / "mesh.ply"
    found = trimesh.load(gs2ci.mesh(bench.run, path))
    areas = sorted((piece.area for piece in found.split(only_watertight=False)), reverse=True)
    share = areas[-1] / areas[0]
    figure = f"{len(areas)} pieces, the least {share:.1%} of the largest"
    yield Row(f"trimesh {trimesh.__version__}", "mesh.ply", figure, ">= 1%", share >= 0.01)


def oiiotool(bench: Bench) -> Iterator[Row]:
    """Compare a depth map's extremes and read its unit by OpenImageIO's tool."""
    file = bench.export("depth-exr", "exr") / "depth_000.exr"
    told = bench.command("oiiotool", "--info", "-v", "--stats", file)
    highest = float(re.findall(r"Stats Max:\s+([\d.eE+-]+)", told)[0])
    wanted = float(bench.run.depth[0].max())  # type: ignore[index]
    yield Row("oiiotool", "EXR, largest depth", f"{highest:g}", f"{wanted:g}", abs(highest / wanted - 1) < 1e-5)
    unit = "".join(re.findall(r'unit: "(.*)"', told))
    yield Row("oiiotool", "EXR, unit", unit, bench.run.report.length_unit, unit == bench.run.report.length_unit)


def punx(bench: Bench) -> Iterator[Row]:
    """Validate a NeXus file."""
    told = bench.command("punx", "validate", bench.export("nexus", "run.nxs"))
    errors = sum(map(int, re.findall(r"^\s*ERROR\s+(\d+)", told, re.MULTILINE)))
    yield Row("punx", "run.nxs", f"{errors} errors", "0", errors == 0)


def axe(bench: Bench) -> Iterator[Row]:
    """Ask axe for faults of the report's page, and count its printed pages."""
    page = write_run_page(bench.run.folder, bench.work / "report.html")
    text = (bench.node / "node_modules/axe-core/axe.min.js").read_text()
    with browser(bench.work / "profile") as tab:
        for width in (400, 1600):
            tab.open(page, width)
            tab.run(f"{text}; 1")
            found = tab.run("axe.run().then(r => r.violations.map(v => v.id))")
            figure = ", ".join(found) or "0 violations"
            yield Row(bench.version("axe-core"), f"report.html at {width} px", figure, "0", not found)
        tab.open(page, 800, paper=True)
        sheets = len(re.findall(rb"/Type\s*/Page\b", tab.pdf()))
    yield Row("Chromium", "report.html on paper", f"{sheets} pages", "<= 4", sheets <= 4)


CLIENTS: tuple[Callable[[Bench], Iterator[Row]], ...] = (
    splat_transform,
    libraries,
    loaders,
    spark,
    gltf_validator,
    colmap,
    mesh,
    oiiotool,
    punx,
    axe,
)


def asked(bench: Bench, names: list[str]) -> Iterator[Row]:
    """Ask one program after the other; what one of them cannot do keeps no other from its turn."""
    for client in CLIENTS:
        if names and client.__name__ not in names:
            continue
        try:
            yield from client(bench)
        except AbsentError as error:
            yield Row(client.__name__, "", str(error))
        except Exception as error:  # whatever another program does is a figure of it
            yield Row(client.__name__, "", f"{type(error).__name__}: {str(error)[:200]}", "", met=False)


def as_page(rows: list[Row]) -> str:
    """Return the table as a page."""
    words = {True: "yes", False: "**no**", None: ""}
    lines = ["| client | file | figure | limit | met |", "|---|---|---|---|---|"]
    lines += [f"| {row.client} | {row.file} | {row.figure} | {row.limit} | {words[row.met]} |" for row in rows]
    return (
        "# Clients\n\nWhat other people's newest programs make of the demonstration's exports, in figures. Written on "
        f"{datetime.now(UTC):%Y-%m-%d} by `make clients RUN=runs/demo/run` (`tests/clients`), which installs them by "
        "npm and pip into a temporary folder and is no part of the tests, because what they do changes without us. "
        "Programs that this machine did not have are said to be absent.\n\n" + "\n".join(lines) + "\n"
    )


def main() -> int:
    """Ask all, print and write the table; 1 if a limit is not met."""
    parser = argparse.ArgumentParser(prog="python -m tests.clients", description=__doc__)
    parser.add_argument("run", help="a run folder")
    parser.add_argument("-o", "--output", type=Path, help="write the table as a page")
    parser.add_argument("--node", type=Path, help="a folder in which npm has installed the packages already")
    parser.add_argument("--only", nargs="*", default=[], help="names of functions in this file")
    given = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        node = given.node or Path(folder) / "node"
        if given.node is None and given.only != ["libraries"]:
            node.mkdir()
            (node / "package.json").write_text('{"private": true}')
            wanted = [f"{name}@latest" for name in NPM]
            subprocess.run(["npm", "install", "--no-audit", "--no-fund", *wanted], cwd=node, check=True)
        rows = []
        for row in asked(Bench(gs2ci.open_run(given.run), Path(folder), node), given.only):
            print(f"{row.client} | {row.file} | {row.figure} | {row.limit} | {row.met}", flush=True)
            rows.append(row)
    if given.output is not None:
        given.output.write_text(as_page(rows))
    return int(any(row.met is False for row in rows))


if __name__ == "__main__":
    sys.exit(main())
