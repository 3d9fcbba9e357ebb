"""Dark signal, photon transfer, signal to noise, lamp."""

from __future__ import annotations

import numpy as np
from rows import Row, acquire, region, rms

PIXELS = {"roi.samples": 500, "roi.sample_offset": 800, "roi.bands": 400, "roi.band_offset": 300}
SMALL = {"roi.samples": 400, "roi.sample_offset": 824, "roi.bands": 120, "roi.band_offset": 380}


def dark(instrument: str, seed: int) -> list[Row]:
    settings = {**PIXELS, "camera.seed": seed, "camera.sensor.hot_per_million": 500}
    model, true, config = acquire(settings, lambda hsi: hsi.calibrate.dark(), instrument)
    here, gain = region(config), true.gain()
    hot, bent = true.hot[here], true.nonlinear[here]
    straight = ~(hot | bent)
    name = f"dark signal, {instrument}, seed {seed}, {hot.size} pixels: "
    rows = []
    for what, fitted, sigma, real in (
        ("a", model.rate, model.rate_sigma, gain * true.dark_e_per_s[here]),
        ("b", model.offset, model.offset_sigma, gain * true.offset_e[here]),
    ):
        share = float(np.mean(np.abs(fitted - real)[straight] <= 3 * sigma[straight]))
        least = 0.9973 - 3 * np.sqrt(0.9973 * 0.0027 / straight.sum())
        rows.append(Row(f"{name}{what} within 3 sigma", "99.7 % of pixels", f"{100 * share:.2f} %", share >= least))
    for what, sigma, asked in (
        ("a", model.rate_sigma, "1.94 e-/s"),
        ("b", model.offset_sigma, "1.51 e-"),
        ("dark at 200 ms", model.sigma_at(0.2), "1.31 e-"),
    ):
        rows.append(Row(f"{name}standard error of {what}, 20 frames", asked, f"{np.median(sigma) / gain:.2f}"))
    found, false = int(model.hot[hot].sum()), float(model.hot[~hot].mean())
    rows.append(
        Row(f"{name}hot pixels found", "all", f"{found} of {int(hot.sum())}", found == int(hot.sum())),
    )
    rows.append(Row(f"{name}false hot pixels", "< 1e-4", f"{false:.1e}", false < 1e-4))
    linear = straight | (hot & ~bent & (true.dark(model.longest_s)[here] < gain * true.full_well_e * 0.98))
    false = float(model.nonlinear[linear].mean())
    rows.append(Row(f"{name}falsely not linear", "< 1e-4", f"{false:.1e}", false < 1e-4))
    if bent.any():
        seen = int(model.nonlinear[bent].sum())
        rows.append(
            Row(f"{name}pixels that level off flagged", "all", f"{seen} of {int(bent.sum())}", seen == bent.sum())
        )
    return rows


def transfer(instrument: str, seed: int) -> list[Row]:
    settings = {**SMALL, "camera.seed": seed}
    found, true, config = acquire(settings, lambda hsi: hsi.calibrate.photon_transfer(), instrument)
    sensor = config.camera.options.sensor
    offset = true.offset_e[region(config)]
    name = f"photon transfer, {instrument}, seed {seed}: "

    def relative(what: str, value: float, real: float, limit: float) -> Row:
        error = value / real - 1
        return Row(
            f"{name}{what}",
            f"{100 * limit:g} %",
            f"{value:.5g} of {real:.5g}: {100 * error:+.2f} %",
            abs(error) < limit,
        )

    full = (
        true.full_well_e if true.full_scale_e >= true.full_well_e + offset.mean() else true.full_scale_e - offset.mean()
    )
    return [
        relative("gain K", found.gain, true.gain(), 0.01),
        Row(
            f"{name}error of the gain over the one given",
            "< 3",
            f"{(found.gain - true.gain()) / found.gain_sigma:+.1f}",
            abs(found.gain - true.gain()) < 3 * found.gain_sigma,
        ),
        relative("read noise, e-", found.read_noise_e, true.read_noise_e, 0.02),
        relative("full well, e-", found.full_well_e, full, 0.02),
        relative("PRNU", found.prnu, sensor.prnu, 0.1),
        *([relative("DSNU, e-", found.dsnu_e, sensor.dsnu_e, 0.1)] if sensor.dsnu_e else []),
        Row(
            f"{name}saturation of EMVA, e-",
            "below the full well",
            f"{found.saturation_e:.0f}: {100 * (found.saturation_e / full - 1):+.1f} %",
            0.9 < found.saturation_e / full < 1.0,
        ),
        Row(f"{name}linearity error", "< 0.5 %", f"{100 * found.linearity_error:.2f} %", found.linearity_error < 0.005),
    ]


def noise() -> list[Row]:
    settings = {**SMALL, "roi.bands": 200, "roi.band_offset": 300, "camera.lamp.flicker": 0.0}
    exposures = [0.01, 0.02, 0.04, 0.06]

    async def protocol(hsi):
        cube = await hsi.calibrate.snr(exposures_s=exposures, frames=40)
        white = await hsi.calibrate.white(exposure_s=0.04, frames=40)
        return cube, white

    (found, white), true, config = acquire(settings, protocol)
    gain = true.gain()
    signal = np.nanmedian(white.mean - white.dark, axis=1) / gain / 0.04  # electrons a second, of each band
    dark_e = np.median(true.dark_e_per_s[region(config)])
    expected = np.array(
        [
            20 * np.log10(signal * t / np.sqrt(signal * t + dark_e * t + true.read_noise_e**2 + 1 / 12 / gain**2))
            for t in found.exposure_s
        ]
    )
    error = found.snr_db - expected
    eq20 = found.snr_paper_db - found.snr_db + 10 * np.log10(0.99)
    return [
        Row("SNR by band and exposure, rms error", "0.2 dB", f"{rms(error):.3f} dB", rms(error) < 0.2),
        Row("SNR by band and exposure, mean error", "0.1 dB", f"{error.mean():+.3f} dB", abs(error.mean()) < 0.1),
        Row("eq. 20 over the usual SNR at R = 0.99", "0.044 dB", f"{eq20.mean() + 0.0436:.4f} dB", rms(eq20) < 1e-6),
    ]


def lamp(seeds: int) -> list[Row]:
    pulls, levels, errors, tau, stable = [], [], [], 0.0, []
    for seed in range(1, seeds + 1):
        settings = {**SMALL, "camera.seed": seed, "camera.scene": "cold-lamp", "camera.lamp.warm_up_s": 120.0}

        async def protocol(hsi):
            return await hsi.calibrate.light(exposure_s=0.03)

        found, true, _ = acquire({**settings, "camera.lamp.on_before_s": 0.0}, protocol)
        tau = true.lamp.warm_up_s
        pulls.append((found.settling_s - tau) / found.settling_sigma_s)
        errors.append(found.settling_s / tau - 1)
        levels.append(found.overshoot - true.lamp.warm_up)
        stable.append(found.stable_after_s / (tau * np.log(true.lamp.warm_up / 0.01)) - 1)
    name = f"lamp, {seeds} seeds, 20 snapshots: "
    return [
        Row(f"{name}time constant, rms error", "known tau recovered", f"{100 * rms(errors):.1f} %", rms(errors) < 0.05),
        Row(f"{name}its error over the one given, rms", "about 1", f"{rms(pulls):.2f}", 0.3 < rms(pulls) < 2),
        Row(f"{name}overshoot of 8 %, rms error", "", f"{100 * rms(levels):.2f} %", rms(levels) < 0.005),
        Row(f"{name}time until within 1 %, rms error", "", f"{100 * rms(stable):.1f} %", rms(stable) < 0.1),
    ]


def rows(seeds: int) -> list[Row]:
    found: list[Row] = []
    for instrument in ("characterise", "sensors2019"):
        for seed in (1, 2):
            found += dark(instrument, seed)
    for instrument in ("characterise", "sensors2019"):
        for seed in (1, 2):
            found += transfer(instrument, seed)
    return [*found, *noise(), *lamp(seeds)]
