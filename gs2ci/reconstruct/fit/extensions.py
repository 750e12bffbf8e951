"""What settings may add to the coarse fits: the interface of a last stage after them.

Not here: any such stage; there is the paper's (`gs2ci.reconstruct.paper.fine`).
"""

from typing import Protocol, Self

from gs2ci.reconstruct.fit.coarse.looks import Decode, Monitoring, Score
from gs2ci.reconstruct.fit.coarse.stage import CoarseFit
from gs2ci.reconstruct.fit.coarse.stopping import HoldOut
from gs2ci.reconstruct.fit.losses.objective import LossWeights
from gs2ci.reconstruct.fit.scene.rendering import ShotRenderer
from gs2ci.reconstruct.measurement.holdout import Holdout


class LastStage(Protocol):
    """A stage after the coarse fits, ready to run."""

    def fit(
        self,
        holdout: Holdout,
        coarse: CoarseFit,
        renderer: ShotRenderer,
        seed: int,
        monitoring: Monitoring,
        decode: Decode,
        score: Score | None = None,
    ) -> CoarseFit:
        """Refine the Gaussians of a coarse fit.

        Args:
            holdout: The measurement (its truth is not read), and its pixels that no loss may see.
            coarse: The fit to continue.
            renderer: Renders for this shot.
            seed: Of random draws.
            monitoring: What is called at looks and iterations, and what may interrupt.
            decode: Its result is added to the scene's views at looks, as before delivery.
            score: Turns refined views into a figure for the curve; it may know the truth.
        """


class LastStageSettings(Protocol):
    """The settings of such a stage."""

    @property
    def iterations(self) -> int:
        """Get the most iterations that it makes."""

    @property
    def hold_out(self) -> HoldOut:
        """Get how often it looks at the held-out pixels, and how long it waits for them to improve."""

    def load(self, loss: LossWeights, seed: int) -> LastStage:
        """Load what the settings name, before any time is spent on the measurement; `loss` is the coarse stage's.

        Raises:
            InputError: The settings make no sense, or a model file cannot be used.
            StorageError: The list of added models cannot be read.
        """

    def with_models(self, prior: str | None, distance: str | None) -> Self:
        """Return the same with another prior or distance, by name; None: as it is."""
