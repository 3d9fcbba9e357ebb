"""Drivers that break one promise each: the suite must say so, in the test that is about it."""

import asyncio
import threading
from dataclasses import replace

import numpy as np
import pytest

from scanhsi.devices import Role, Sweep, find
from scanhsi.devices.errors import DeviceError, OutOfRange
from scanhsi.testing.conformance import ActuatorConformance, CameraConformance
from scanhsi.testing.devices import _used

CAMERA, ACTUATOR = find(Role.CAMERA, "simulated"), find(Role.ACTUATOR, "simulated")
GoodCamera, GoodActuator = CAMERA.device, ACTUATOR.device
CAMERA_OPTIONS = CAMERA.options(bands=40, samples=64, scene="testpattern")


class ClampsInSilence(GoodCamera):
    async def configure(self, settings):
        allowed = self.info.exposure
        return await super().configure(
            replace(settings, exposure_s=float(np.clip(settings.exposure_s, allowed.minimum, allowed.maximum)))
        )


class ReturnsTooEarly(GoodCamera):
    async def expose(self):
        exposing = asyncio.ensure_future(super().expose())
        self.later = [*getattr(self, "later", []), exposing]
        await asyncio.sleep(0.001)
        exposure = await exposing
        return replace(exposure, end_ns=exposure.end_ns + 5_000_000)


class SkipsAFrame(GoodCamera):
    def frames(self):
        stream = super().frames()

        class Skipping:
            def __aiter__(self):
                return self

            async def __anext__(self):
                event = await anext(stream)
                return await anext(stream) if event.index == 2 else event

        return Skipping()


class LetsItsBufferBeWritten(GoodCamera):
    def frames(self):
        stream = super().frames()

        class Writable:
            def __aiter__(self):
                return self

            async def __anext__(self):
                event = await anext(stream)
                event.payload = np.zeros(event.pixel_format.payload_bytes(event.shape), np.uint8)
                return event

        return Writable()


class ReusesItsBuffer(GoodCamera):
    memory = None

    def frames(self):
        stream, camera = super().frames(), self

        class Reusing:
            def __aiter__(self):
                return self

            async def __anext__(self):
                event = await anext(stream)
                if camera.memory is None:
                    camera.memory = np.empty(event.pixel_format.payload_bytes(event.shape), np.uint8)
                camera.memory[:] = event.index
                event.payload = camera.memory.view()
                event.payload.flags.writeable = False
                return event

        return Reusing()


class LeavesATask(GoodCamera):
    async def connect(self):
        await super().connect()
        self.task = asyncio.ensure_future(asyncio.sleep(1e6))


class RaisesWhatTheLibraryRaised(GoodCamera):
    async def expose(self):
        try:
            return await super().expose()
        except DeviceError as error:
            raise KeyError("handle 7") from error


class ClosesOnce(GoodCamera):
    closed = False

    async def close(self):
        if self.closed:
            raise RuntimeError("closed already")
        await super().close()
        self.closed = True


class CountsOn(GoodCamera):
    before = 0

    async def expose(self):
        exposure = await super().expose()
        return replace(exposure, index=exposure.index + self.before)

    async def disarm(self):
        await super().disarm()
        self.before += 2


class HasTooManyBits(GoodCamera):
    async def unpack(self, frame, out):
        await super().unpack(frame, out)
        if out is not None and out.dtype == np.uint16:
            out[0, 0] = 0xFFFF


class DoesNotSurviveACancelledConnect(GoodCamera):
    halfway = False

    async def connect(self):
        if self.halfway:
            raise DeviceError("connecting already")
        self.halfway = True
        await asyncio.sleep(0.001)
        await super().connect()
        self.halfway = False


class ForgetsACancelledExposure(GoodCamera):
    skip = 0

    async def expose(self):
        try:
            return await super().expose()
        except asyncio.CancelledError:
            self.skip += 1
            raise

    def frames(self):
        stream, camera = super().frames(), self

        class Forgetting:
            def __aiter__(self):
                return self

            async def __anext__(self):
                event = await anext(stream)
                if camera.skip:
                    camera.skip -= 1
                    return await anext(stream)
                return event

        return Forgetting()


class StampsByAnotherClock(GoodCamera):
    def frames(self):
        stream = super().frames()

        class Shifted:
            def __aiter__(self):
                return self

            async def __anext__(self):
                event = await anext(stream)
                event.received_ns += 10**15
                return event

        return Shifted()


class OpensOnce(GoodCamera):
    closed = False

    async def connect(self):
        if self.closed:
            raise DeviceError("make a new object")
        await super().connect()

    async def close(self):
        await super().close()
        self.closed = True


class ForetellsTwice(GoodCamera):
    async def expose_foretold(self, foretold):
        def twice(end_ns):
            foretold(end_ns)
            foretold(end_ns)

        return await super().expose_foretold(twice)


class TakesAnyPeriod(GoodCamera):
    async def set_frame_period(self, period_s):
        try:
            return await super().set_frame_period(period_s)
        except OutOfRange:
            return period_s


class ShowsWhileArmed(GoodCamera):
    async def show(self, scene):
        if scene != self.scene:
            await super().show(scene)


BAD_CAMERAS = [
    (DoesNotSurviveACancelledConnect, "test_any_method_may_be_cancelled:connect:1"),
    (ForgetsACancelledExposure, "test_a_cancelled_exposure_that_was_triggered_counts:0.5"),
    (StampsByAnotherClock, "test_frames_are_stamped_on_the_clock_of_the_loop"),
    (OpensOnce, "test_the_same_object_can_be_opened_anew"),
    (ForetellsTwice, "test_the_end_is_foretold"),
    (TakesAnyPeriod, "test_a_frame_period_that_is_too_short_is_refused"),
    (ShowsWhileArmed, "test_scenes"),
    (ClampsInSilence, "test_what_is_not_allowed_is_refused_and_changes_nothing"),
    (ReturnsTooEarly, "test_expose_returns_at_the_end_of_exposure"),
    (SkipsAFrame, "test_each_exposure_is_one_frame_or_in_one_gap_in_order"),
    (LetsItsBufferBeWritten, "test_pixels_of_every_format"),
    (HasTooManyBits, "test_pixels_of_every_format"),
    (ReusesItsBuffer, "test_a_frame_lives_as_long_as_it_is_looked_at"),
    (LeavesATask, "test_close_is_idempotent_and_may_come_at_any_time"),
    (RaisesWhatTheLibraryRaised, "test_out_of_order_calls_are_errors_of_the_tree"),
    (ClosesOnce, "test_close_is_idempotent_and_may_come_at_any_time"),
    (CountsOn, "test_expose_returns_at_the_end_of_exposure"),
]


def call(suite, test):
    """Run a test of a suite, written as ``name:argument:...``."""
    name, *words = test.split(":")
    getattr(suite, name)(*(float(word) if "." in word else int(word) if word.isdigit() else word for word in words))


@pytest.mark.parametrize(("bad", "test"), BAD_CAMERAS, ids=lambda value: getattr(value, "__name__", value))
def test_bad_cameras_are_caught(bad, test):
    class Suite(CameraConformance):
        virtual = True
        patience_s = 20.0

        def make(self):
            return bad(CAMERA_OPTIONS.model_copy(update={"bench": bad.__name__}))

    if test.startswith("test_expose") and bad is CountsOn:
        check_counting(Suite())
        return
    with pytest.raises((AssertionError, TimeoutError, ValueError, RuntimeError, KeyError, DeviceError, ExceptionGroup)):
        call(Suite(), test)


def check_counting(suite):
    async def twice(camera):
        await suite.ready(camera)
        await camera.disarm()
        await suite.ready(camera)
        assert (await camera.expose()).index == 0

    with pytest.raises(AssertionError):
        suite.run(twice)


class KnowsNoLimits(GoodActuator):
    async def move_to(self, step):
        try:
            return await super().move_to(step)
        except OutOfRange:
            return await super().move_to(int(np.clip(step, -2400, 2400)))


class EndsBesideItsTarget(GoodActuator):
    async def move_to(self, step):
        motion = await super().move_to(step)
        return replace(motion, step=motion.step + (step == 1))


class DoesNotHearStop(GoodActuator):
    async def stop(self):
        await asyncio.sleep(0)
        raise DeviceError("busy")


class LeavesAThread(GoodActuator):
    async def connect(self):
        await super().connect()
        self.thread = threading.Thread(target=threading.Event().wait, args=(15,))
        self.thread.start()


class HomesElsewhere(GoodActuator):
    async def home(self):
        motion = await super().home()
        await super().move_to(2)
        return motion


class SweepsFaster(GoodActuator):
    def check_sweep(self, sweep: Sweep) -> Sweep:
        return replace(super().check_sweep(sweep), rate_steps_s=sweep.rate_steps_s * 1.1)


class StampsBackwards(GoodActuator):
    async def move_to(self, step):
        motion = await super().move_to(step)
        return replace(motion, commanded_ns=motion.moved_ns, moved_ns=motion.commanded_ns - 1)


class OpensOnceOnly(GoodActuator):
    closed = False

    async def connect(self):
        if self.closed:
            raise DeviceError("make a new object")
        await super().connect()

    async def close(self):
        await super().close()
        self.closed = True


class HomesAfterStop(GoodActuator):
    async def stop(self):
        if getattr(self, "homing", False):
            raise DeviceError("homing cannot be stopped")
        await super().stop()

    async def home(self):
        self.homing = True
        motion = await super().home()
        self.homing = False
        return motion


class SaysItIsElsewhere(GoodActuator):
    async def locate(self):
        sighting = await super().locate()
        return replace(sighting, step=sighting.step + 5000)


class PromisesTooMuch(GoodActuator):
    def least_latency_s(self, step):
        return super().least_latency_s(step) + 10.0


BAD_ACTUATORS = [
    (OpensOnceOnly, "test_the_same_object_can_be_opened_anew"),
    (HomesAfterStop, "test_stop_ends_homing"),
    (SaysItIsElsewhere, "test_sweeps_downwards_and_tells_where_it_is"),
    (PromisesTooMuch, "test_tells_when_it_begins_to_move"),
    (KnowsNoLimits, "test_limits_hold_before_anything_moves"),
    (EndsBesideItsTarget, "test_it_goes_where_it_is_told"),
    (StampsBackwards, "test_it_goes_where_it_is_told"),
    (DoesNotHearStop, "test_stop_of_what_stands"),
    (LeavesAThread, "test_info"),
    (HomesElsewhere, "test_home_is_step_0"),
    (SweepsFaster, "test_sweeps"),
]


@pytest.mark.parametrize(("bad", "test"), BAD_ACTUATORS, ids=lambda value: getattr(value, "__name__", value))
def test_bad_actuators_are_caught(bad, test):
    class Suite(ActuatorConformance):
        virtual = True

        def make(self):
            return bad(ACTUATOR.options(bench=bad.__name__))

    _used.add(Suite)  # what is left behind counts from the first use
    with pytest.raises((AssertionError, DeviceError, ExceptionGroup)):
        call(Suite(), test)
