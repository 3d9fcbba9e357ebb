"""Which exposure a frame belongs to, without a camera."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from scanhsi.devices.frames import FrameGap
from scanhsi_aravis.order import ID_CYCLE, ById, ByTrigger, Outcome, Pending, id_distance

MS = 1_000_000


def camera_ids(first: int, count: int) -> list[int]:
    """16-bit frame ids of `count` exposures in a row."""
    return [(first - 1 + i) % ID_CYCLE + 1 for i in range(count)]


def account(outcomes: list[Outcome]) -> list[tuple[int, bool]]:
    """(index, whether its frame arrived) of all that was reported, in order of the reports."""
    told: list[tuple[int, bool]] = []
    for gaps, index in outcomes:
        told += [(i, False) for gap in gaps for i in range(gap.first, gap.first + gap.count)]
        if index is not None:
            told.append((index, True))
    return told


@pytest.mark.parametrize(
    ("previous", "current", "distance"),
    [(1, 2, 1), (65535, 1, 1), (65534, 1, 2), (65535, 65536, 1), (7, 7, 0), (2**40, 2**40 + 5, 5), (65400, 64, 199)],
)
def test_distance_of_ids(previous: int, current: int, distance: int) -> None:
    assert id_distance(previous, current) == distance


@given(st.integers(1, ID_CYCLE), st.integers(0, ID_CYCLE - 1))
def test_distance_over_the_wrap(first: int, ahead: int) -> None:
    assert id_distance(first, camera_ids(first, ahead + 1)[-1]) == ahead


@given(st.integers(65_000, 2**63), st.integers(0, 10**9))
def test_ids_of_64_bits_do_not_wrap(first: int, ahead: int) -> None:
    assert id_distance(first, first + ahead) == ahead


# What may become of an exposure: it arrives, arrives broken, or never shows up.
fates = st.lists(st.sampled_from(["whole", "broken", "gone"]), min_size=1, max_size=200)


@given(st.integers(1, ID_CYCLE), fates)
def test_by_id_reports_each_exposure_once_and_in_order(first: int, fate: list[str]) -> None:
    fate = ["whole", *fate, "whole"]  # what is lost before the first or after the last frame cannot be known
    order = ById()
    outcomes: list[Outcome] = []
    for frame_id, what in zip(camera_ids(first, len(fate)), fate, strict=True):
        if what == "whole":
            outcomes.append(order.arrived(frame_id))
        elif what == "broken":
            outcomes.append((order.lost("packets were lost"), None))
    told = account(outcomes)
    assert [index for index, _ in told] == list(range(len(fate)))
    # Within one run of losses nobody knows which frame it was that arrived broken, but each is a gap.
    assert [arrived for _, arrived in told] == [what == "whole" for what in fate]


def test_a_frame_reported_as_lost_is_not_delivered_later() -> None:
    order = ById()
    assert order.arrived(10) == ([], 0)
    assert order.lost("late") == [FrameGap(1, 1, "late")]
    assert order.lost("late") == [FrameGap(2, 1, "late")]
    assert order.arrived(11) == ([], None)
    assert order.arrived(13) == ([], 3)


class Triggers:
    """A `ByTrigger` with a clock: triggers every 30 ms, stamped by a device whose clock is 5 s ahead."""

    def __init__(self) -> None:
        self.order = ByTrigger()
        self.pending: list[Pending] = []

    def fire(self) -> None:
        pending = Pending()
        sent_ns = (len(self.pending) + 1) * 30 * MS
        self.order.triggered(pending, sent_ns)
        pending.due_ns = sent_ns + 1000 * MS
        self.pending.append(pending)

    def frame(self, frame_id: int, trigger: int | None) -> Outcome:
        """A frame that the camera stamped 0.4 ms after it got that trigger."""
        stamp = None if trigger is None else self.pending[trigger].sent_ns + 5_000 * MS + 400_000
        return self.order.arrived(frame_id, stamp)


def test_each_trigger_gets_its_frame() -> None:
    triggers = Triggers()
    for i in range(5):
        triggers.fire()
        assert triggers.frame(100 + i, i) == ([], i)
    assert not triggers.order.pending


def test_a_lost_frame_shows_in_the_ids() -> None:
    triggers = Triggers()
    triggers.fire()
    triggers.frame(65535, None)
    triggers.fire()
    triggers.fire()
    gaps, index = triggers.frame(2, None)
    assert (gaps[0].first, gaps[0].count, index) == (1, 1, 2)


def test_an_ignored_trigger_shows_in_the_stamps() -> None:
    triggers = Triggers()
    triggers.fire()
    triggers.frame(7, 0)
    triggers.fire()
    triggers.fire()
    gaps, index = triggers.frame(8, 2)  # no id is missing: the camera never exposed the second
    assert ([gap.first for gap in gaps], index) == ([1], 2)


def test_two_in_flight_are_not_mistaken_for_each_other() -> None:
    triggers = Triggers()
    triggers.fire()
    triggers.frame(7, 0)
    triggers.fire()
    triggers.fire()
    assert triggers.frame(8, 1) == ([], 1)
    assert triggers.frame(9, 2) == ([], 2)


def test_what_is_due_is_given_up_and_its_late_frame_dropped() -> None:
    triggers = Triggers()
    triggers.fire()
    due_ns = triggers.pending[0].due_ns or 0
    assert triggers.order.expired(due_ns - 1, "late") == []
    assert triggers.order.expired(due_ns, "late") == [FrameGap(0, 1, "late")]
    assert triggers.frame(50, 0) == ([], None)
    triggers.fire()
    assert triggers.frame(51, 1) == ([], 1)


def test_a_trigger_that_never_reached_the_camera_was_none() -> None:
    triggers = Triggers()
    triggers.fire()
    triggers.order.refused(triggers.pending[0])
    again = Pending()
    triggers.order.triggered(again, 90 * MS)
    assert again.index == 0


@given(fates)
def test_by_trigger_reports_each_exposure_once_and_in_order(fate: list[str]) -> None:
    triggers = Triggers()
    outcomes: list[Outcome] = []
    for i, (frame_id, what) in enumerate(zip(camera_ids(65500, len(fate)), fate, strict=True)):
        triggers.fire()
        if what == "whole":
            outcomes.append(triggers.frame(frame_id, i))
        elif what == "broken":
            outcomes.append((triggers.order.lost("packets were lost"), None))
        else:
            outcomes.append((triggers.order.expired(triggers.pending[i].due_ns or 0, "late"), None))
    assert account(outcomes) == [(i, what == "whole") for i, what in enumerate(fate)]


def test_a_reported_loss_is_not_counted_again_by_its_id() -> None:
    triggers = Triggers()
    triggers.fire()
    triggers.frame(7, None)
    triggers.fire()
    assert triggers.order.lost("packets were lost") == [FrameGap(1, 1, "packets were lost")]
    triggers.fire()
    triggers.fire()
    assert triggers.frame(9, None) == ([], 2)
    assert triggers.frame(10, None) == ([], 3)
