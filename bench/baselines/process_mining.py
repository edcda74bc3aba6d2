"""Process mining: pm4py's correlation miner, which needs no case numbers (Pourmirza 2015).

It takes the passages of all cameras as activities with a begin and an end, and returns which
activity follows which, how often and after which mean time: the integer programme that explains the
least time between them. pm4py is under the AGPL, so it is a tool of the bench only, which the
package neither needs nor ships.
"""

from __future__ import annotations

import warnings
from collections import Counter
from collections.abc import Sequence

from bench.support.recordings import TRANSITIONS_MIN, TRANSITIONS_SHARE_MIN, CameraPair, Passage

WHOLE_PASSAGES_MAX = 3000
"""Passages up to which the miner looks at all of them together; it cuts more into parts."""
_COLUMNS = {
    "pm4py:param:activity_key": "concept:name",
    "pm4py:param:timestamp_key": "time:timestamp",
    "pm4py:param:start_timestamp_key": "start_timestamp",
}


def mined_links(passages: Sequence[Passage]) -> dict[CameraPair, float]:
    """Return the mean transit time of each link that the miner finds, seconds.

    Links are the edges between cameras with as many transitions as a true link has. Raises
    ModuleNotFoundError if pm4py or pandas is not installed.
    """
    import pandas as pd
    from pm4py.algo.discovery.correlation_mining import algorithm

    frame = pd.DataFrame(
        {
            "concept:name": [passage.camera for passage in passages],
            "start_timestamp": pd.to_datetime(
                [passage.begin for passage in passages], unit="s", utc=True
            ),
            "time:timestamp": pd.to_datetime(
                [passage.end for passage in passages], unit="s", utc=True
            ),
        }
    )
    variants = algorithm.Variants
    whole = len(passages) <= WHOLE_PASSAGES_MAX
    variant = variants.CLASSIC if whole else variants.CLASSIC_SPLIT
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", PendingDeprecationWarning)  # pm4py uses numpy.matrix
        counts, seconds = algorithm.apply(frame, variant=variant, parameters=_COLUMNS)
    exits = Counter[str]()
    for (source, target), number in counts.items():
        exits[source] += number if source != target else 0
    return {
        pair: float(seconds[pair])
        for pair, number in counts.items()
        if pair[0] != pair[1]
        and number >= max(TRANSITIONS_MIN, TRANSITIONS_SHARE_MIN * exits[pair[0]])
    }
