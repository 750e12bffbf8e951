from gs2ci.api.bundles import update_bundle as update_bundle
from gs2ci.api.costs import tradeoff as tradeoff
from gs2ci.api.decoding import decode as decode
from gs2ci.api.demonstration import demo_rig as demo_rig
from gs2ci.api.designing import design as design
from gs2ci.api.exports import export as export
from gs2ci.api.exports import mesh as mesh
from gs2ci.api.many import reconstruct_many as reconstruct_many
from gs2ci.api.models import add_model as add_model
from gs2ci.api.models import export_model as export_model
from gs2ci.api.models import list_models as list_models
from gs2ci.api.ophyd import ophyd_bench as ophyd_bench
from gs2ci.api.plans import explain as explain
from gs2ci.api.plans import plan as plan
from gs2ci.api.plugins import list_plugins as list_plugins
from gs2ci.api.preparing import compile_kernels as compile_kernels
from gs2ci.api.reconstruction import reconstruct as reconstruct
from gs2ci.api.rigs import OpenRig as OpenRig
from gs2ci.api.rigs import find_devices as find_devices
from gs2ci.api.rigs import open_rig as open_rig
from gs2ci.api.runs import Run as Run
from gs2ci.api.runs import open_run as open_run
from gs2ci.api.scoring import evaluate as evaluate
from gs2ci.api.scoring import measure as measure
from gs2ci.api.shots import import_file as import_file
from gs2ci.api.shots import load as load
from gs2ci.api.shots import recover as recover
from gs2ci.api.shots import save as save
from gs2ci.api.sweeps import sweep as sweep
from gs2ci.core.errors import DeviceError as DeviceError
from gs2ci.core.errors import GeometryError as GeometryError
from gs2ci.core.errors import Gs2ciError as Gs2ciError
from gs2ci.core.errors import InputError as InputError
from gs2ci.core.errors import NumericsError as NumericsError
from gs2ci.core.errors import ResourceError as ResourceError
from gs2ci.core.errors import StorageError as StorageError
from gs2ci.core.progress import Progress as Progress
from gs2ci.core.progress import Silent as Silent
from gs2ci.core.records import Shot as Shot
from gs2ci.core.records import Truth as Truth
from gs2ci.render.gaussians import Gaussians as Gaussians

__version__: str

__all__ = [
    "DeviceError",
    "Gaussians",
    "GeometryError",
    "Gs2ciError",
    "InputError",
    "NumericsError",
    "OpenRig",
    "Progress",
    "ResourceError",
    "Run",
    "Shot",
    "Silent",
    "StorageError",
    "Truth",
    "__version__",
    "add_model",
    "compile_kernels",
    "decode",
    "demo_rig",
    "design",
    "evaluate",
    "explain",
    "export",
    "export_model",
    "find_devices",
    "import_file",
    "list_models",
    "list_plugins",
    "load",
    "measure",
    "mesh",
    "open_rig",
    "open_run",
    "ophyd_bench",
    "plan",
    "reconstruct",
    "reconstruct_many",
    "recover",
    "save",
    "sweep",
    "tradeoff",
    "update_bundle",
]
