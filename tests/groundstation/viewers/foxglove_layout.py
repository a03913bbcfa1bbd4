"""The layout for Foxglove, written by its own library: ``python -m`` this module writes it anew."""

from __future__ import annotations

import json
from pathlib import Path

import foxglove.layouts as fl

import groundstation.viewers

PATH = Path(groundstation.viewers.__file__).parent / "layouts" / "foxglove.json"
COLOURS = {"mav0": "#0073b2", "mav1": "#d65e00", "mav2": "#009e73"}  # as in the scene


def layout() -> str:
    """Return scene, log and two plots, as Foxglove imports them."""
    scene = fl.ThreeDeePanel(
        title="Fleet",
        config=fl.ThreeDeeConfig(
            follow_tf="fleet",
            follow_mode="follow-none",
            # the scene names each vehicle itself
            scene=fl.BaseRendererSceneSettings(
                transforms=fl.BaseRendererTransforms(show_label=False, line_width=0.0)
            ),
            layers={"grid": fl.BaseRendererGridLayerSettings()},
            topics={
                "/scene": fl.BaseRendererSceneUpdateTopicSettings(visible=True),
                "/scene/law": fl.BaseRendererSceneUpdateTopicSettings(visible=False),
                "/scene/people": fl.BaseRendererSceneUpdateTopicSettings(visible=True),
                "/scene/static": fl.BaseRendererSceneUpdateTopicSettings(visible=True),
                "/positions": fl.BaseRendererPointCloudTopicSettings(visible=False),
            },
        ),
    )
    log = fl.LogPanel(config=fl.LogConfig(topic_to_render="/log", min_log_level=2))
    right = fl.SplitContainer(
        direction="column",
        items=[
            fl.SplitItem(
                content=_plot("Distance to the nearest vehicle [m]", "nearest_distance_m")
            ),
            fl.SplitItem(content=_plot("What the law changes [m/s²]", "intervention_m_s2")),
            fl.SplitItem(content=log),
        ],
    )
    content = fl.SplitContainer(
        direction="row",
        items=[fl.SplitItem(proportion=2, content=scene), fl.SplitItem(content=right)],
    )
    return json.dumps(json.loads(fl.Layout(content=content).to_json()), indent=2) + "\n"


def _plot(title: str, field: str) -> fl.PlotPanel:
    paths = [
        fl.PlotSeries(value=f'"telemetry/{name}".{field}', label=name, color=colour, enabled=True)
        for name, colour in COLOURS.items()
    ]
    return fl.PlotPanel(title=title, config=fl.PlotConfig(paths=paths, show_legend=True))


if __name__ == "__main__":
    PATH.write_text(layout(), encoding="utf-8")
