"""Draw who imports whom while loading, read from the source: ``docs/images/imports.svg``.

Modules stand in layers, each above everything that it imports; an import that another one implies
is left out. Long arrows run through gaps that are kept free for them in every layer.

    python docs/make_import_diagram.py
"""

from __future__ import annotations

import html
import itertools
import sys
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parent.parent / "tests"))

from test_imports import ORDER, RIM, imports

TARGET = Path(__file__).resolve().parent / "images" / "imports.svg"
BOX, GAP, LAYER = (134.0, 34.0), 18.0, 78.0  # width and height, px
SLOT = 26.0  # width of the gap for a long arrow
MARGIN, NOTE = 16.0, 34.0
SWEEPS = 40
COLOURS = {  # fill and edge
    "general": ("#e0f2e9", "#009e73"),
    "robots": ("#e8f1f8", "#0072b2"),
    "rim": ("#fff3e0", "#d55e00"),
}

Graph = Mapping[str, frozenset[str]]
Place = tuple[str, int]  # a module, or (through its name) a long arrow, in a layer


def loaded() -> Graph:
    """For every module or folder of the package those that it imports while loading."""
    found = imports()
    return {
        family: frozenset(
            item.internal
            for item in found
            if item.family == family
            and item.when == "load"
            and item.internal in ORDER
            and item.internal != family
        )
        for family in ORDER
    }


def everything_below(graph: Graph, name: str) -> frozenset[str]:
    """What a module imports, and what that imports, and so on."""
    below = graph[name]
    return below.union(*(everything_below(graph, other) for other in below))


def reduced(graph: Graph) -> Graph:
    """The graph without the imports that others imply."""
    implied = {
        name: frozenset().union(*(everything_below(graph, other) for other in below))
        for name, below in graph.items()
    }
    return {name: below - implied[name] for name, below in graph.items()}


def layers_of(graph: Graph) -> dict[str, int]:
    """Layer of every module: 0 for those that import none, else one above the highest below it."""
    layers: dict[str, int] = {}
    for name in ORDER:  # imports go down the order
        layers[name] = max((layers[other] + 1 for other in graph[name]), default=0)
    return layers


@dataclass(frozen=True)
class Drawing:
    """Centres of everything that has a place, and the arrows as the places they run through."""

    centres: Mapping[Place, tuple[float, float]]
    arrows: tuple[tuple[Place, ...], ...]
    width: float
    height: float


def arranged(graph: Graph) -> Drawing:
    """Places with few crossings: every layer sorted by the mean place of its neighbours."""
    layers = layers_of(graph)
    arrows = []
    for name, below in graph.items():
        for other in sorted(below, key=ORDER.index):
            between = [(f"{name} > {other}", k) for k in range(layers[name] - 1, layers[other], -1)]
            arrows.append(((name, layers[name]), *between, (other, layers[other])))
    rows: list[list[Place]] = [[] for _ in range(max(layers.values()) + 1)]
    for place in dict.fromkeys(itertools.chain(*arrows, layers.items())):
        rows[place[1]].append(place)
    neighbours: dict[Place, list[Place]] = {place: [] for row in rows for place in row}
    for upper, lower in itertools.chain(*(itertools.pairwise(arrow) for arrow in arrows)):
        neighbours[upper].append(lower)
        neighbours[lower].append(upper)
    x = _spread(rows)
    for sweep in range(SWEEPS):
        for row in rows if sweep % 2 else reversed(rows):
            wanted = {
                place: sum(x[other] for other in near) / len(near) if near else x[place]
                for place in row
                for near in [neighbours[place]]
            }
            row.sort(key=lambda place: wanted[place])
            x |= _fitted(row, wanted)
    left = min(x[place] - _width(place) / 2 for place in x)
    right = max(x[place] + _width(place) / 2 for place in x)
    top = len(rows) - 1
    centres = {
        place: (x[place] - left + MARGIN, (top - place[1]) * LAYER + BOX[1] / 2 + MARGIN)
        for place in x
    }
    height = top * LAYER + BOX[1] + 2 * MARGIN + NOTE
    return Drawing(centres, tuple(arrows), right - left + 2 * MARGIN, height)


def _width(place: Place) -> float:
    return BOX[0] if place[0] in ORDER else SLOT


def _spread(rows: list[list[Place]]) -> dict[Place, float]:
    x: dict[Place, float] = {}
    for row in rows:
        x |= _fitted(row, dict.fromkeys(row, 0.0))
    return x


def _fitted(row: list[Place], wanted: Mapping[Place, float]) -> dict[Place, float]:
    """Places of a row as near as may be to where they want to be, in their order, none overlapping.

    Least squares with an order (pool adjacent violators): those in each other's way move together.
    """
    offsets = [0.0]
    for before, after in itertools.pairwise(row):
        offsets.append(offsets[-1] + (_width(before) + _width(after)) / 2 + GAP)
    pools: list[list[float]] = []
    for place, offset in zip(row, offsets, strict=True):
        pools.append([wanted[place] - offset])
        while len(pools) > 1 and _mean(pools[-2]) >= _mean(pools[-1]):
            pools[-2:] = [pools[-2] + pools[-1]]
    shifts = [_mean(pool) for pool in pools for _ in pool]
    return {p: s + offset for p, s, offset in zip(row, shifts, offsets, strict=True)}


def _mean(values: list[float]) -> float:
    return sum(values) / len(values)


def svg(graph: Graph) -> str:
    """The picture, the same text for the same graph."""
    drawing = arranged(reduced(graph))
    width, height = drawing.width, drawing.height
    out = [
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width:.0f} {height:.0f}" '
        f'width="{width:.0f}" height="{height:.0f}" font-family="sans-serif" font-size="14">',
        "<title>Imports of microbot_ocp: each module stands above those that it imports</title>",
        '<defs><marker id="tip" viewBox="0 0 8 8" refX="7" refY="4" markerWidth="7" '
        'markerHeight="7" orient="auto"><path d="M0 0L8 4L0 8z" fill="#607d8b"/></marker></defs>',
        f'<rect width="{width:.0f}" height="{height:.0f}" fill="#fff"/>',
    ]
    for arrow in drawing.arrows:
        points = [drawing.centres[place] for place in arrow]
        out.append(_curve(points))
    for name in ORDER:
        x, y = drawing.centres[name, layers_of(reduced(graph))[name]]
        fill, edge = COLOURS[_kind(graph, name)]
        out.append(
            f'<rect x="{x - BOX[0] / 2:.1f}" y="{y - BOX[1] / 2:.1f}" width="{BOX[0]:.0f}" '
            f'height="{BOX[1]:.0f}" rx="5" fill="{fill}" stroke="{edge}"/>'
            f'<text x="{x:.1f}" y="{y + 5:.1f}" text-anchor="middle" fill="#222">'
            f"{html.escape(name)}</text>"
        )
    out.append(_legend(height))
    return "\n".join([*out, "</svg>", ""])


def _kind(graph: Graph, name: str) -> str:
    if name in RIM:
        return "rim"
    return "robots" if name == "robot" or "robot" in everything_below(graph, name) else "general"


def _curve(points: list[tuple[float, float]]) -> str:
    """From the lower edge of the importing module to the upper edge of the imported one."""
    (x0, y0), (x1, y1) = points[0], points[-1]
    points = [(x0, y0 + BOX[1] / 2), *points[1:-1], (x1, y1 - BOX[1] / 2)]
    path = [f"M{points[0][0]:.1f} {points[0][1]:.1f}"]
    for (xa, ya), (xb, yb) in itertools.pairwise(points):
        middle = (ya + yb) / 2
        path.append(f"C{xa:.1f} {middle:.1f} {xb:.1f} {middle:.1f} {xb:.1f} {yb:.1f}")
    return (
        f'<path d="{" ".join(path)}" fill="none" stroke="#607d8b" stroke-width="1.3" '
        'marker-end="url(#tip)"/>'
    )


def _legend(height: float) -> str:
    parts, x = [], MARGIN
    for kind, text in (
        ("general", "knows no robot"),
        ("robots", "knows robots"),
        ("rim", "the rim: imported by nobody on load"),
    ):
        fill, edge = COLOURS[kind]
        parts.append(
            f'<rect x="{x:.0f}" y="{height - 32:.0f}" width="18" height="14" rx="3" '
            f'fill="{fill}" stroke="{edge}"/>'
            f'<text x="{x + 25:.0f}" y="{height - 20:.0f}" fill="#444">{text}</text>'
        )
        x += 60 + 7.2 * len(text)
    return "".join(parts)


def main() -> None:
    TARGET.write_text(svg(loaded()), "utf-8")
    print(TARGET)


if __name__ == "__main__":
    main()
