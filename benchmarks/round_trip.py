"""Round trip of a key on a slider to the page: viser against panel, in Chromium, without solver.

Both servers receive the value, and return a line and a chart of six curves of 400 samples; the
reported time until the line is on the page is the median of 40 keys.

    python -m benchmarks.round_trip        (needs viser, panel, playwright and chromium)

Without a graphics card the processor draws viser's 3-D view: a small window shows the time of the
libraries, a large one adds the time of drawing.
"""

# pyright: reportMissingImports=false
from __future__ import annotations

import shutil
import time
from collections.abc import Callable
from statistics import median

import numpy as np
from playwright.sync_api import Page, sync_playwright

KEYS, PORT = 40, 8465
T = np.linspace(0.0, 2.0, 400)


def curves(value: float) -> list[np.ndarray]:
    return [100.0 * np.sin(value + k + T) for k in range(6)]


def with_viser() -> Callable[[], None]:
    import viser

    server = viser.ViserServer("127.0.0.1", PORT, verbose=False)
    line, slider = server.gui.add_markdown("answer 0"), server.gui.add_slider("x", 0, 100, 1, 0)
    series = tuple({"label": str(k)} for k in range(7))
    chart = server.gui.add_uplot((T, *curves(0)), series)

    def answer(_: object) -> None:
        chart.data = (T, *curves(slider.value))
        line.content = f"answer {slider.value}"

    slider.on_update(answer)
    return server.stop


def with_panel() -> Callable[[], None]:
    import panel
    from bokeh.models import ColumnDataSource
    from bokeh.plotting import figure

    def page() -> object:
        slider, line = panel.widgets.IntSlider(end=100), panel.pane.Markdown("answer 0")
        source, plot = ColumnDataSource(_columns(0)), figure()
        for k in range(6):
            plot.line("t", str(k), source=source)

        def answer(event: object) -> None:
            source.data, line.object = _columns(slider.value), f"answer {slider.value}"

        slider.param.watch(answer, "value")
        return panel.Column(slider, line, plot)

    server = panel.serve(page, port=PORT, address="127.0.0.1", show=False, threaded=True)
    return server.stop


def _columns(value: float) -> dict[str, np.ndarray]:
    return {"t": T, **{str(k): curve for k, curve in enumerate(curves(value))}}


def main() -> None:
    options = {"executable_path": shutil.which("chromium"), "args": ["--no-sandbox"]}
    for name, serve in {"viser": with_viser, "panel": with_panel}.items():
        for width, height in ((420, 300), (1280, 720)):
            stop = serve()
            time.sleep(3.0)  # start of the server, s
            with sync_playwright() as playwright:
                browser = playwright.chromium.launch(**options)
                times = _times(browser.new_page(viewport={"width": width, "height": height}))
            stop()
            print(f"{name}, {width} x {height}: {median(times):.0f} ms, at most {max(times):.0f}")


def _times(page: Page) -> list[float]:
    page.goto(f"http://127.0.0.1:{PORT}")
    thumb, times = page.get_by_role("slider").first, []
    thumb.wait_for(timeout=60_000)
    page.wait_for_timeout(2000)
    for key in range(1, KEYS + 1):
        begin = time.perf_counter()
        thumb.press("ArrowRight")
        page.get_by_text(f"answer {key}", exact=True).wait_for()
        times.append(1e3 * (time.perf_counter() - begin))
    return times


if __name__ == "__main__":
    main()
