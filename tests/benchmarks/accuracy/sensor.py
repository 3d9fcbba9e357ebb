"""Dark signal, photon transfer, signal to noise, lamp."""

from __future__ import annotations

import numpy as np
from rows import Row, acquire, region, rms

PIXELS = {"roi.samples": 500, "roi.sample_offset": 800, "roi.bands": 400, "roi.band_offset": 300}
SMALL = {"roi.samples": 400, "roi.sample_offset": 824, "roi.bands": 120, "roi.band_offset": 380}


def dark(instrument: str, seeds: int) -> list[Row]:
    """Of sensors with one hot pixel in 2000; in ``characterise`` a fifth of them levels off."""
    within: dict[str, list[float]] = {"a": [], "b": []}
    errors: list[list[float]] = []
    counts = np.zeros(7)
    for seed in range(1, seeds + 1):
        settings = {**PIXELS, "camera.seed": seed, "camera.sensor.hot_per_million": 500}
        model, true, config = acquire(settings, lambda hsi: hsi.calibrate.dark(), instrument)
        here, gain = region(config), true.gain()
        hot, bent = true.hot[here], true.nonlinear[here]
        straight = ~(hot | bent)
        for what, fitted, sigma, real in (
            ("a", model.rate, model.rate_sigma, gain * true.dark_e_per_s[here]),
            ("b", model.offset, model.offset_sigma, gain * true.offset_e[here]),
        ):
            within[what].append(float(np.mean(np.abs(fitted - real)[straight] <= 3 * sigma[straight])))
        errors.append(
            [float(np.median(one)) / gain for one in (model.rate_sigma, model.offset_sigma, model.sigma_at(0.2))]
        )
        parts = (hot, model.hot & hot, ~hot, model.hot & ~hot, bent, model.nonlinear & bent, model.nonlinear & straight)
        counts += [part.sum() for part in parts]
    hots, found, cool, false, bents, seen, wrong = counts
    least = 0.9973 - 3 * np.sqrt(0.9973 * 0.0027 / (cool / seeds))
    rows = [
        Row(f"**dark signal**, `{instrument}`, {seeds} sensors of 200 000 pixels, 8 exposures of 20 frames", "", "")
    ]
    for what, shares in within.items():
        worst = min(shares)
        rows.append(
            Row(
                f"{what} within 3 sigma of the truth, worst sensor",
                "99.7 % of pixels",
                f"{100 * worst:.2f} %",
                worst > least,
            )
        )
    for what, asked, value in zip(
        ("a", "b", "dark at 200 ms"), ("1.94 e-/s", "1.51 e-", "1.31 e-"), np.mean(errors, axis=0).tolist(), strict=True
    ):
        rows.append(Row(f"standard error of {what}", asked, f"{value:.2f}"))
    return [
        *rows,
        Row("hot pixels found", "all", f"{found:.0f} of {hots:.0f}", found == hots),
        Row("others taken for hot", "< 1e-4", f"{false:.0f} of {cool:.0f}", false < 1e-4 * cool),
        *([Row("pixels that level off flagged", "all", f"{seen:.0f} of {bents:.0f}", seen == bents)] if bents else []),
        Row("others taken for not linear", "< 1e-4", f"{wrong:.0f} of {cool:.0f}", wrong < 1e-4 * cool),
    ]


def transfer(instrument: str, seeds: int) -> list[Row]:
    """Relative errors; full scale of the converter lies above the full well in ``characterise``, and at it in ``sensors2019``."""
    errors: dict[str, list[float]] = {}
    pulls, limits = [], {"gain K": 0.01, "read noise": 0.02, "full well": 0.02, "PRNU": 0.1, "DSNU": 0.1}
    for seed in range(1, seeds + 1):
        protocol = lambda hsi: hsi.calibrate.photon_transfer()  # noqa: E731
        found, true, config = acquire({**SMALL, "camera.seed": seed}, protocol, instrument)
        sensor, offset = config.camera.options.sensor, float(true.offset_e[region(config)].mean())
        full = min(true.full_well_e, true.full_scale_e - offset)
        pulls.append((found.gain - true.gain()) / found.gain_sigma)
        seen = {
            "gain K": found.gain / true.gain(),
            "read noise": found.read_noise_e / true.read_noise_e,
            "full well": found.full_well_e / full,
            "PRNU": found.prnu / sensor.prnu,
            "saturation of EMVA 1288, against the full well": found.saturation_e / full,
            "linearity error": 1 + found.linearity_error,
        }
        if sensor.dsnu_e:
            seen["DSNU"] = found.dsnu_e / sensor.dsnu_e
        for what, ratio in seen.items():
            errors.setdefault(what, []).append(ratio - 1)
    rows = [Row(f"**photon transfer**, `{instrument}`, {seeds} sensors, pairs at 18 exposures", "", "")]
    for what, off in errors.items():
        if what in limits:
            reached = f"{100 * rms(off):.2f} % rms, {100 * np.mean(off):+.2f} % mean"
            rows.append(Row(what, "EMVA 1288", reached, rms(off) < limits[what]))
        else:
            rows.append(Row(what, "", f"{100 * np.mean(off):+.2f} %"))
    return [*rows, Row("error of K over the one given, rms", "about 1", f"{rms(pulls):.2f}", rms(pulls) < 1.8)]


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
        Row("**signal to noise**, 200 bands, 10 to 60 ms, 40 frames", "", ""),
        Row("SNR by band and exposure, rms error", "(our limit: 0.2 dB)", f"{rms(error):.3f} dB", rms(error) < 0.2),
        Row(
            "SNR by band and exposure, mean error",
            "(our limit: 0.1 dB)",
            f"{error.mean():+.3f} dB",
            abs(error.mean()) < 0.1,
        ),
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
    return [
        Row(f"**lamp** of tau 120 s, overshoot 8 %, drift and flicker, {seeds} times 20 snapshots in 800 s", "", ""),
        Row("time constant, rms error", "known tau recovered", f"{100 * rms(errors):.1f} %", rms(errors) < 0.05),
        Row("its error over the one given, rms", "about 1", f"{rms(pulls):.2f}", 0.3 < rms(pulls) < 2),
        Row("overshoot, rms error", "", f"{100 * rms(levels):.2f} %", rms(levels) < 0.005),
        Row("time until within 1 %, rms error", "", f"{100 * rms(stable):.1f} %", rms(stable) < 0.1),
    ]


def rows(seeds: int) -> list[Row]:
    few = max(2, seeds // 5)
    found: list[Row] = []
    for instrument in ("characterise", "sensors2019"):
        found += dark(instrument, few)
    for instrument in ("characterise", "sensors2019"):
        found += transfer(instrument, few)
    return [*found, *noise(), *lamp(max(2, seeds // 2))]
