"""Figures of a result for notebooks and papers: data in, :class:`matplotlib.figure.Figure` out."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np

from gtau.estimation.results.estimate import Estimate
from gtau.estimation.results.singularity_distances import Distances
from gtau.report.residuals import autocorrelation, histogram, spectrum
from gtau.report.style import (
    BLACK,
    BLUE,
    GREY,
    IDENTIFIED,
    LINES,
    PRIOR,
    VERMILION,
    joint_label,
    light_grid,
    new_figure,
)
from gtau.report.style import styled as in_style

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

KINDS = ("type 1 (serial)", "type 2 (parallel)")


def gains_figure(gains: Mapping[str, Estimate], prior: Mapping[str, float]) -> Figure:
    """Draw drive gains with their 95 % intervals, and prior ones, in per cent from the identified gain."""
    with in_style():
        figure = new_figure(6.4, 1.1 + 0.42 * len(gains))
        axes = figure.subplots()
        axes.axvline(0.0, color=BLACK, linewidth=0.9)
        for row, (joint, gain) in enumerate(gains.items()):
            ends = gain.interval()
            if not gain.value:
                continue
            half = 0.0 if ends is None else 100 * (ends[1] - ends[0]) / 2 / abs(gain.value)
            label = "identified, 95 % interval" if row == 0 else None
            axes.errorbar([0.0], [row], xerr=[half], linestyle="none", label=label, **IDENTIFIED)
            if joint in prior:
                off = 100 * (prior[joint] / gain.value - 1)
                axes.plot([off], [row], linestyle="none", label="prior" if row == 0 else None, **PRIOR)
        labels = [f"{joint_label(joint)}\n{gain.value or 0.0:.5g} {gain.unit}" for joint, gain in gains.items()]
        axes.set_yticks(range(len(gains)), labels)
        axes.set_ylim(len(gains) - 0.5, -0.5)
        axes.set_xlabel("from the identified gain, %")
        light_grid(axes, "x")
        figure.legend(*axes.get_legend_handles_labels(), loc="outside upper center", ncols=2)
    return figure


def residuals_figure(time: np.ndarray, values: np.ndarray, title: str, unit: str) -> Figure:
    """Draw residuals (K,), NaN where masked, along ``time`` (K,), with histogram, spectrum and autocorrelation."""
    series = [(time, values)]
    found = histogram(series), spectrum(series), autocorrelation(series)
    with in_style():
        figure = new_figure(7.2, 4.4)
        above, *below = (figure.add_subplot(2, 3, place) for place in ((1, 3), 4, 5, 6))
        above.axhline(0.0, color=GREY, linewidth=0.8)
        above.plot(time - time[0], values, color=VERMILION, linewidth=1.0)
        above.set(title=title, xlabel="time, s", ylabel=f"residual, {unit}")
        if found[0] is not None:
            below[0].stairs(found[0].density, found[0].edges, fill=True, color=BLUE, alpha=0.5)
            x = np.linspace(found[0].edges[0], found[0].edges[-1], 100)
            below[0].plot(x, found[0].normal(x), color=VERMILION)
            below[0].set(title=f"std {found[0].std:.3g} {unit}", xlabel=f"residual, {unit}", ylabel="density")
        if found[1] is not None:
            below[1].semilogy(found[1].frequency, np.sqrt(found[1].density), color=BLUE)
            _plain_log(below[1])
            below[1].set(title="Spectrum", xlabel="frequency, Hz", ylabel=f"{unit}/√Hz")
        if found[2] is not None:
            below[2].axhspan(-found[2].band, found[2].band, color="#E4E4E4")
            below[2].plot(found[2].lag, found[2].value, color=BLUE)
            below[2].set(title="Autocorrelation", xlabel="lag, s")
        for axes in (above, *below):
            light_grid(axes)
            axes.set_xlim(*axes.dataLim.intervalx)
    return figure


def _plain_log(axes: Axes) -> None:
    """Write powers of ten on a logarithmic axis as plain text: names with a $ rule out mathematical markup."""
    from matplotlib.ticker import NullFormatter

    axes.yaxis.set_major_formatter("{x:g}")
    axes.yaxis.set_minor_formatter(NullFormatter())


def correlation_figure(covariance: np.ndarray, names: Sequence[str]) -> Figure:
    """Draw the correlation matrix of the estimates that have a variance."""
    std = np.sqrt(np.clip(np.diag(covariance), 0.0, None))
    known = np.flatnonzero(std > 0).tolist()
    matrix = covariance[np.ix_(known, known)] / np.outer(std[known], std[known])
    with in_style():
        size = float(np.clip(0.12 * len(known), 4.0, 12.0))
        figure = new_figure(size + 1.4, size)
        axes = figure.subplots()
        image = axes.imshow(matrix, cmap="RdBu", vmin=-1.0, vmax=1.0)
        figure.colorbar(image, label="correlation", shrink=0.8)
        fontsize = float(np.clip(60 * size / max(len(known), 1), 3.0, 9.0))
        chosen = [names[k] for k in known]
        axes.set_xticks(range(len(known)), chosen, rotation=90, fontsize=fontsize)
        axes.set_yticks(range(len(known)), chosen, fontsize=fontsize)
        axes.tick_params(length=0)
    return figure


def singular_values_figure(values: np.ndarray) -> Figure:
    """Draw singular values (K,) in falling order, the smallest apart."""
    order = np.arange(1, len(values) + 1)
    with in_style():
        figure = new_figure(5.4, 3.0)
        axes = figure.subplots()
        axes.semilogy(order[:-1], values[:-1], linestyle="none", marker="o", markersize=3.5, color=BLUE)
        axes.semilogy(order[-1:], values[-1:], linestyle="none", marker="D", markersize=5, color=VERMILION)
        axes.set_title(f"The smallest is {values[-2] / values[-1]:.3g} times below the next")
        _plain_log(axes)
        axes.set(xlabel="number", ylabel="singular value")
        light_grid(axes)
    return figure


def distances_figure(distances: Sequence[Distances], starts: Mapping[str, float]) -> Figure:
    """Draw distances to singular poses along runs, which begin at ``starts`` (s) by name."""
    with in_style():
        figure = new_figure(7.2, 0.8 + 1.5 * len(distances))
        panels = figure.subplots(len(distances), 1, squeeze=False)[:, 0]
        for axes, each in zip(panels, distances, strict=True):
            for kind, values, style in zip(KINDS, each.values.T, LINES[:2], strict=True):
                if np.isfinite(values).any():
                    axes.plot(each.time - starts.get(each.run, 0.0), values, label=kind, **style)
            axes.set_ylim(0.0, 1.05)
            axes.set_title(each.run)
            axes.set_ylabel("distance")
            light_grid(axes)
        panels[-1].set_xlabel("time from the start of the run, s")
        figure.legend(*panels[0].get_legend_handles_labels(), loc="outside upper center", ncols=2)
    return figure
