"""The twin's sensor: triggers, exposure windows, and what the mirror showed in them. No time passes here."""

from dataclasses import dataclass, field

import pytest

from scanhsi_sim.twins.mirror import MirrorReading
from scanhsi_sim.twins.sensor import LINK_PERIOD_NS, READOUT_NS, Exposed, Sensor, Settings, Source

MS = 1_000_000
T_EXP = 30 * MS


@dataclass
class Bench:
    """A sensor, a mirror, and a clock that the test turns."""

    now: int = 0
    room: bool = True
    position: int = 100
    moved_ns: int = 0
    steps: int = 0
    done: list[Exposed] = field(default_factory=list[Exposed])
    sensor: Sensor = field(init=False)

    def __post_init__(self) -> None:
        self.sensor = Sensor(self.look, lambda: self.room)

    def look(self) -> MirrorReading:
        return MirrorReading(self.position, self.moved_ns, self.steps, 0, 0, 0)

    def arm(self, source: Source, exposure_ns: int = T_EXP, period_us: int = 0) -> None:
        settings = Settings(source, exposure_ns // 1000, period_us, 0, 0, (2, 2), (0, 0))
        self.sensor.start(settings, self.now)

    def step(self, by: int = 1) -> None:
        self.position += by
        self.steps += abs(by)
        self.moved_ns = self.now

    def run_to(self, time_ns: int) -> None:
        """Call `advance` whenever the sensor asks for it."""
        while (due := self.sensor.wakeup_ns()) is not None and due <= time_ns:
            self.now = max(self.now, due)
            self.done += self.sensor.advance(self.now)
        self.now = time_ns

    def trigger(self, source: Source = Source.SOFTWARE, late_ns: int = 0, position: int | None = None) -> None:
        self.done += self.sensor.advance(self.now + late_ns)
        self.sensor.trigger(source, self.now, self.now + late_ns, position)

    def spans(self) -> list[tuple[int, int]]:
        return [(exposed.step_low, exposed.step_high) for exposed in self.done]


@pytest.fixture
def bench() -> Bench:
    return Bench()


def test_a_still_mirror_gives_one_step(bench: Bench) -> None:
    bench.arm(Source.SOFTWARE)
    bench.now = 5 * MS
    bench.trigger()
    bench.run_to(100 * MS)
    assert [(e.start_ns, e.end_ns) for e in bench.done] == [(5 * MS, 5 * MS + T_EXP)]
    assert bench.spans() == [(100, 100)]
    assert bench.sensor.counters.smeared == 0


@pytest.mark.parametrize("when_ns", [1, 15 * MS, T_EXP - 1])
def test_a_move_during_the_exposure_is_seen(bench: Bench, when_ns: int) -> None:
    bench.arm(Source.SOFTWARE)
    bench.trigger()
    bench.run_to(when_ns)
    bench.step(-3)
    bench.run_to(100 * MS)
    assert bench.spans() == [(97, 100)]
    assert bench.sensor.counters.smeared == 1


def test_a_move_there_and_back_is_seen(bench: Bench) -> None:
    bench.arm(Source.SOFTWARE)
    bench.trigger()
    bench.run_to(10 * MS)
    bench.step(2)
    bench.step(-2)
    bench.run_to(100 * MS)
    assert bench.spans() == [(100, 102)]


def test_a_move_after_the_end_is_not_seen_however_late_the_twin_wakes(bench: Bench) -> None:
    bench.arm(Source.SOFTWARE)
    bench.trigger()
    bench.run_to(T_EXP - 1)
    bench.now = T_EXP + 2 * MS
    bench.step(8)
    bench.done += bench.sensor.advance(T_EXP + 5 * MS)
    assert bench.spans() == [(100, 100)]


def test_a_move_between_the_trigger_and_a_late_look_is_seen(bench: Bench) -> None:
    bench.arm(Source.SOFTWARE)
    bench.now = 1
    bench.step()
    bench.now = 0
    bench.trigger(late_ns=MS)
    bench.run_to(100 * MS)
    assert bench.sensor.counters.smeared == 1


def test_a_pulse_tells_where_the_mirror_was(bench: Bench) -> None:
    bench.arm(Source.LINE1)
    bench.position, bench.moved_ns, bench.steps = 103, MS, 3
    bench.trigger(Source.LINE1, late_ns=MS, position=102)
    bench.run_to(100 * MS)
    assert bench.spans() == [(102, 103)]


def test_positions_are_told_within_one_turn_around_home(bench: Bench) -> None:
    bench.position = 19_200 - 5
    bench.arm(Source.SOFTWARE)
    bench.trigger()
    bench.run_to(100 * MS)
    assert bench.spans() == [(-5, -5)]


def test_triggers_that_come_too_early_are_lost_and_counted(bench: Bench) -> None:
    bench.arm(Source.SOFTWARE, exposure_ns=MS)
    for when in (0, MS // 2, READOUT_NS - 1, READOUT_NS):
        bench.run_to(when)
        bench.trigger()
    bench.run_to(100 * MS)
    assert [e.start_ns for e in bench.done] == [0, READOUT_NS]
    assert bench.sensor.counters.busy == 2


def test_a_trigger_may_come_before_the_twin_knows_of_the_start(bench: Bench) -> None:
    bench.now = 5 * MS
    bench.arm(Source.SOFTWARE)
    bench.now = 4 * MS  # the kernel's time of the packet; the twin was late to take the one before
    bench.trigger(late_ns=MS)
    bench.run_to(100 * MS)
    assert len(bench.done) == 1


def test_a_long_exposure_may_begin_when_the_last_one_ends(bench: Bench) -> None:
    bench.arm(Source.SOFTWARE)
    for when in (0, T_EXP):
        bench.run_to(when)
        bench.trigger()
    bench.run_to(100 * MS)
    assert len(bench.done) == 2


def test_a_full_memory_loses_the_exposure_and_counts_it(bench: Bench) -> None:
    bench.room = False
    bench.arm(Source.SOFTWARE)
    bench.trigger()
    bench.run_to(100 * MS)
    assert (bench.done, bench.sensor.counters.unread) == ([], 1)


def test_only_the_armed_source_fires(bench: Bench) -> None:
    bench.trigger()
    bench.arm(Source.LINE1)
    bench.trigger(Source.SOFTWARE)
    bench.run_to(100 * MS)
    assert (bench.done, bench.sensor.counters.ignored) == ([], 2)


def test_stopping_gives_up_the_exposure(bench: Bench) -> None:
    bench.arm(Source.SOFTWARE)
    bench.trigger()
    bench.sensor.stop()
    bench.run_to(100 * MS)
    assert bench.done == []
    assert bench.sensor.wakeup_ns() is None


@pytest.mark.parametrize(
    ("source", "exposure_ns", "period_us", "period_ns"),
    [
        (Source.FREE_RUN, MS, 500_000, LINK_PERIOD_NS),
        (Source.FREE_RUN, T_EXP, 500_000, T_EXP),
        (Source.FIXED_RATE, MS, 50_000, 50 * MS),
        (Source.FIXED_RATE, 80 * MS, 50_000, 80 * MS),
    ],
)
def test_a_free_run_keeps_its_period(
    bench: Bench, source: Source, exposure_ns: int, period_us: int, period_ns: int
) -> None:
    bench.arm(source, exposure_ns, period_us)
    bench.run_to(10 * period_ns)
    starts = [e.start_ns for e in bench.done]
    assert starts == [k * period_ns for k in range(len(starts))]
    assert len(starts) >= 9


def test_frames_count_from_zero_in_each_acquisition(bench: Bench) -> None:
    for _ in range(2):
        bench.arm(Source.SOFTWARE)
        bench.trigger()
        bench.run_to(bench.now + 100 * MS)
        bench.sensor.stop()
    assert [e.index for e in bench.done] == [0, 0]
