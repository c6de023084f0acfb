"""Axes: what is labelled, and what is kept of a long curve."""

import numpy as np
import pytest

from usdface.media.charts.axes import add_axes, add_label, new_figure, plot_curve, render


def test_there_is_no_half_frame_and_one_frame_is_a_dot() -> None:
    figure = new_figure(400, 200)
    axes = add_axes(figure, (40, 20, 340, 150), whole=True)
    axes.set_xlim(99.5, 100.5)
    axes.set_ylim(0, 1)
    plot_curve(axes, np.array([100.0]), np.array([0.5]), (255, 0, 0))
    picture = render(figure)
    labels = {label.get_position()[0]: label.get_text() for label in axes.get_xticklabels()}
    assert {at: label for at, label in labels.items() if 99.5 <= at <= 100.5} == {100: "100"}
    assert (picture == (255, 0, 0)).all(axis=2).sum() > 30


def test_a_long_curve_keeps_its_peaks() -> None:
    heights = np.zeros(400_000)
    heights[123_456] = 1.0
    figure = new_figure(400, 200)
    axes = add_axes(figure, (40, 20, 340, 150))
    axes.set_xlim(0, len(heights))
    axes.set_ylim(-0.1, 1.1)
    plot_curve(axes, np.arange(400_000.0), heights, (255, 0, 0))
    picture = render(figure).astype(int)
    red = (picture[..., 0] > 150) & (picture[..., 1] < 60)
    assert red[40].sum() in (1, 2, 3)
    assert np.flatnonzero(red[40]).mean() == pytest.approx(40 + 340 * 123_456 / 400_000, abs=2)


def test_gaps_stay_open_and_sparse_frames_are_joined() -> None:
    def red_columns(heights: np.ndarray) -> np.ndarray:
        figure = new_figure(400, 200)
        axes = add_axes(figure, (40, 20, 340, 150))
        axes.set_xlim(0, 340)
        axes.set_ylim(0, 1)
        plot_curve(axes, np.arange(340.0), heights, (255, 0, 0))
        picture = render(figure).astype(int)
        return ((picture[..., 0] > 150) & (picture[..., 1] < 60)).any(axis=0)[40:380]

    every = np.full(340, 0.5)
    every[100:200] = np.nan
    fifth = np.where(np.arange(340) % 5 == 0, 0.5, np.nan)
    assert not red_columns(every)[105:195].any()
    assert red_columns(fifth)[5:330].all()


def test_dollars_and_letters_without_a_glyph_are_drawn() -> None:
    figure = new_figure(300, 100)
    axes = add_axes(figure, (20, 40, 260, 40), caption="a$b$ 撮影")
    add_label(axes, "$\\frac$", (0, 0.5))
    assert render(figure)[:30].max() > 200
