"""The page with via points to drag, in a real browser."""

import shutil
import sys

import numpy as np
import pytest

import microbot_ocp as mo
from helpers import refused, tells
from microbot_ocp.views import _studio

VIA_Q = np.radians([[0, 0, 0], [-8, 45, 30], [-90, 90, 90]])
OPTIONS = (
    "--no-sandbox",
    "--disable-gpu",
    "--disable-quic",
    "--no-first-run",
    "--disable-sync",
    "--disable-background-networking",
    "--disable-component-update",
)
BROWSER = shutil.which("chromium") or shutil.which("chromium-browser")


@pytest.fixture
def page():
    pytest.importorskip("viser")
    browsers = pytest.importorskip("playwright.sync_api")
    if BROWSER is None:
        pytest.skip("there is no chromium")
    with browsers.sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=BROWSER, args=list(OPTIONS))
        yield browser.new_page()
        browser.close()


@pytest.mark.slow
def test_sliders_move_the_motion_and_nothing_comes_from_elsewhere(page):
    addresses = []
    page.on("request", lambda request: addresses.append(request.url))
    page.on("websocket", lambda socket: addresses.append(socket.url))
    studio = mo.views.studio(mo.load_robot("microbot"), VIA_Q)
    try:
        page.goto(studio.address)
        page.get_by_text("1.924 s, 7 % saved").wait_for()
        assert page.locator("canvas").count() >= 3  # the arm and two charts
        thumbs = page.get_by_role("slider")
        for _ in range(4):
            thumbs.nth(2).press("ArrowRight")  # the payload, in steps of 0.05 kg
        page.get_by_text("2.056 s").first.wait_for()
        assert studio.robot.links[-1].mass == pytest.approx(
            mo.load_robot("microbot").links[-1].mass + 0.2
        )
        thumbs.nth(3).press("ArrowRight")  # waist of via point 2, by one degree
        page.wait_for_timeout(500)
        assert studio.wait()
        at = studio.motion.marks[1].time
        assert np.degrees(studio.motion.sample(at).q[0]) == pytest.approx([-7, 45, 30], abs=0.01)
    finally:
        studio.close()
    host = studio.address.removeprefix("http://")
    assert any(address.startswith("ws://") for address in addresses)
    assert all(host in address for address in addresses)


@pytest.mark.slow
def test_a_via_point_is_dragged_and_stays_where_it_was_out_of_reach(page):
    axe = pytest.importorskip("axe_core_python.sync_playwright").Axe()
    studio = mo.views.studio(mo.load_robot("microbot"))  # with the demo's via points
    try:
        page.goto(studio.address)
        page.get_by_text("1.924 s, 7 % saved").wait_for()
        page.wait_for_timeout(1500)
        first = studio._grips[1].position
        _drag(page, studio, down=1.2 * studio._grips[1].scale)
        moved, at = studio._grips[1].position, studio.motion.marks[1].time
        assert moved[:2] == pytest.approx(first[:2], abs=0.01)
        assert moved[2] < first[2] - 0.5
        tool = mo.forward_kinematics(studio.robot)(studio.motion.sample(at).q[0])
        assert np.ravel(np.array(tool)[:3, 3]) == pytest.approx(moved, abs=0.01)
        shown = [float(thumb.get_attribute("aria-valuenow")) for thumb in _thumbs(page)[3:]]
        assert shown == pytest.approx(np.degrees(studio._via_q[1]), abs=0.02)
        _drag(page, studio, down=-9.0)
        page.get_by_role("heading", name="via point 2: out of reach").wait_for()
        assert studio._grips[1].position[2] < 9.0
        ours = axe.run(page, "div:has(> h2)")  # the page's own words; the rest is viser's markup
        assert not ours["violations"]
        assert ours["passes"]
    finally:
        studio.close()


def _thumbs(page):
    return page.get_by_role("slider").all()


def _drag(page, studio, down):
    """Drag via point 2 by its upright arrow, so many metres."""
    grip = studio._grips[1]
    arrow = np.array([0.0, 0.0, 0.8 * grip.scale])
    begin, end = (_on_screen(page, studio, grip.position + arrow - [0, 0, k]) for k in (0.0, down))
    page.mouse.move(*begin)
    page.wait_for_timeout(300)
    page.mouse.down()
    for share in np.linspace(0.1, 1.0, 10):
        page.mouse.move(*(begin + share * (end - begin)))
        page.wait_for_timeout(50)
    page.mouse.up()
    page.wait_for_timeout(500)
    assert studio._drags.wait()
    assert studio.wait()


def _on_screen(page, studio, point):
    camera = next(iter(studio._server.get_clients().values())).camera
    x, y, depth = studio._turns(camera.wxyz).as_matrix().T @ (point - camera.position)
    box = page.locator("canvas").first.bounding_box()
    dots = box["height"] / 2 / np.tan(camera.fov / 2)
    middle = [box["x"] + box["width"] / 2, box["y"] + box["height"] / 2]
    return np.array(middle) + dots * np.array([x, y]) / depth


def test_a_setting_without_a_motion_shows_none():
    pytest.importorskip("viser")
    from microbot_ocp.views.live import Setting

    studio = mo.views.studio(mo.load_robot("microbot"), VIA_Q, dark=True)
    try:
        assert studio.saved == pytest.approx(1 - 1.9239 / 2.0737, abs=1e-3)
        studio._work.ask(Setting(torque=0.6, payload=2.0))
        assert studio.wait()
        assert studio.motion is None
        assert studio.saved is None
        tells(studio._headline.content, "no motion", "not solved", "via point 1")
        assert not any(chart.visible for chart in studio._charts.values())
    finally:
        studio.close()


def test_what_it_refuses(monkeypatch):
    robot = mo.load_robot("microbot")
    with refused("port", "1, not 0"):
        mo.views.studio(robot, port=0)
    monkeypatch.setitem(sys.modules, "viser", None)
    with refused("viser", "pip install 'microbot_ocp[studio]'"):
        mo.views.studio(robot)


@pytest.mark.parametrize("name", ["ur5e", "puma560", "panda", "stanford"])
def test_from_the_poses_that_it_begins_with_arms_can_be_dragged(name: str) -> None:
    """In the middle of their ranges these are stretched out, or two axes of the wrist in line."""
    robot = mo.load_robot(name)
    jacobian = mo.jacobian(robot)
    for q in _studio._bent_poses(robot):
        assert np.linalg.svd(np.array(jacobian(q)), compute_uv=False).min() > 0.01
