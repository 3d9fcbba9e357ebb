"""The twin's sensor: which triggers count, and when the shutter is open. No time passes here."""

from dataclasses import dataclass, field

import pytest

from scanhsi_sim.twins.sensor import LINK_PERIOD_NS, READOUT_NS, Exposure, Sensor, Settings, Source

MS = 1_000_000
T_EXP = 30 * MS


@dataclass
class Bench:
    """A sensor, and a clock that the test turns."""

    now: int = 0
    room: bool = True
    done: list[Exposure] = field(default_factory=list[Exposure])
    sensor: Sensor = field(init=False)

    def __post_init__(self) -> None:
        self.sensor = Sensor(lambda: self.room)

    def arm(self, source: Source, exposure_ns: int = T_EXP, period_us: int = 0) -> None:
        self.sensor.start(Settings(source, exposure_ns // 1000, period_us, 0, 0, (2, 2), (0, 0)), self.now)

    def run_to(self, time_ns: int) -> None:
        """Call `advance` whenever the sensor asks for it."""
        while (due := self.sensor.wakeup_ns()) is not None and due <= time_ns:
            self.now = max(self.now, due)
            self.done += self.sensor.advance(self.now)
        self.now = time_ns

    def trigger(self, source: Source = Source.SOFTWARE, late_ns: int = 0) -> None:
        self.done += self.sensor.advance(self.now + late_ns)
        self.sensor.trigger(source, self.now)


@pytest.fixture
def bench() -> Bench:
    return Bench()


def test_the_shutter_opens_at_the_trigger_for_the_exposure_time(bench: Bench) -> None:
    bench.arm(Source.SOFTWARE)
    bench.now = 5 * MS
    bench.trigger(late_ns=2 * MS)
    bench.run_to(100 * MS)
    assert [(e.start_ns, e.end_ns) for e in bench.done] == [(5 * MS, 5 * MS + T_EXP)]


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
