"""The exposures of a joint run among shots that are given: which shot belongs to which of its views.

Here: that choice. Not here: their figures (`evaluation`), the record of exposures (`report.ExposureSection`).
"""

from collections import Counter
from collections.abc import Sequence

from gs2ci.core.errors import InputError
from gs2ci.core.records import Shot
from gs2ci.evaluate.report import Report


def exposures_of(report: Report, shots: Sequence[Shot]) -> list[Shot]:
    """Return the shots of a run in the order of its views.

    Shots are found by the names of the run's exposures, in any order; those that it left out are passed over. If names
    do not tell, as many as the run has are taken as they are given.

    Args:
        report: Of the run.
        shots: One or more; of a run of one exposure, that one.

    Raises:
        InputError: They are not those of the run: some are missing, or there are more of one name than it has.
    """
    wanted = [one.name for one in report.exposures] or [report.name]
    given, of_run = Counter(shot.name for shot in shots), Counter(wanted)
    lacking = [name for name in of_run if given[name] < of_run[name]]
    doubtful = [name for name in of_run if given[name] > of_run[name]]
    if len(shots) == len(wanted) and lacking:
        return list(shots)
    if lacking or doubtful:
        told = f"{', '.join(lacking or doubtful)} {'is missing' if lacking else 'is there more than once'}"
        raise InputError(
            f"{len(shots)} exposures beside a run of {len(wanted)}: {told}",
            allowed="the exposures that were reconstructed",
            remedy="give the files of the run, all exposures of each, in the same order; see --index",
        )
    by_name: dict[str, list[Shot]] = {}
    for shot in shots:
        by_name.setdefault(shot.name, []).append(shot)
    return [by_name[name].pop(0) for name in wanted]
