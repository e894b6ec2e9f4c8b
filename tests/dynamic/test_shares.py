"""A piece of work in shares: every one done once, whoever does it."""

import threading

import pytest

from luxel.dynamic.shares import in_shares
from luxel.picture.drawing import Crew


@pytest.mark.parametrize("count", [0, 1, 7, 8, 100])
@pytest.mark.parametrize("threads", [1, 2, 5])
def test_shares_are_a_partition_in_order(count, threads):
    crew = Crew(threads)
    found = in_shares(lambda share: list(range(share.start, share.stop)), count, crew)
    crew.close()
    assert [k for part in found for k in part] == list(range(count))
    assert len(found) == max(1, min(2 * threads, count // 4)) or threads == 1
    assert in_shares(lambda share: share, count, None) == [slice(0, count)]


def test_several_threads_take_part():
    both = threading.Barrier(2)
    waited = []

    def meet(share):
        if not waited or threading.get_ident() not in waited:
            waited.append(threading.get_ident())
            both.wait(30)  # nobody gets on unless two threads are here

    crew = Crew(2)
    in_shares(meet, 16, crew)
    crew.close()
    assert len(set(waited)) == 2


def test_an_error_in_a_share_reaches_the_caller():
    def fail(share):
        raise ValueError(share.start)

    crew = Crew(2)
    with pytest.raises(ValueError, match=r"\d"):
        in_shares(fail, 64, crew)
    crew.close()
