"""CUDA devices and their driver, as plain records.

Not here: who asks for them (`trial.py`), the choice among them (`devices.py`).
"""

from dataclasses import dataclass


@dataclass(frozen=True)
class Card:
    """One CUDA device.

    Args:
        device: Its name here, such as "cuda:0".
        model: Its maker's name for it.
        capability: Its compute capability, major and minor.
        memory_mib: What it has.
        free_mib: What other programs leave of it.
    """

    device: str
    model: str
    capability: tuple[int, int]
    memory_mib: int
    free_mib: int


@dataclass(frozen=True)
class Cuda:
    """What Warp says of a computer.

    Args:
        driver: The CUDA version of its driver; None if the driver does not answer.
        least_driver: The lowest that Warp runs on.
        least_capability: The lowest compute capability that kernels can be compiled for.
        cards: In the driver's order; none if the driver is too old.
    """

    driver: tuple[int, int] | None
    least_driver: tuple[int, int]
    least_capability: tuple[int, int]
    cards: tuple[Card, ...] = ()
