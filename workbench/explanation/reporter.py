"""What a diagnosis reports while it runs."""

from collections.abc import Callable
from dataclasses import dataclass

from workbench.core.covariates import clock
from workbench.diagnosis.linear.ends import Ends
from workbench.explanation.sentences.statements import with_sample_numbers

ReportProgress = Callable[[str], None]


@dataclass(frozen=True)
class Reporter:
    """Called with what is done; `first`, `provisional`: called with what the first search found, see `diagnose`."""

    progress: ReportProgress
    first: ReportProgress
    provisional: Callable[[dict], None]

    def __call__(self, text: str) -> None:
        self.progress(text)


def with_numbered_samples(progress: ReportProgress, bench) -> ReportProgress:
    """As `progress`, for the lines of a search on a bench: an instant lies between two samples, by their numbers.

    The search of an arm counts rows from 0, and places an instant half a row behind one.
    """
    if bench.chain is None:
        return progress
    chain, ids = bench.chain, bench.recording.sample_ids
    order = Ends(chain.poses_per_sample, len(ids)).mean(clock(chain.state))
    return lambda line: progress(with_sample_numbers(line, order, ids))
