"""The script of the live page, run in node before a made-up document."""

from __future__ import annotations

from tests.groundstation.web.live_page import needs_node, run_page

pytestmark = needs_node


def test_a_page_whose_server_shows_another_fleet_now_is_loaded_again() -> None:
    counts = run_page("""
    const found = [FLEET, FLEET, { ...FLEET, name: "hall" }].map((fleet) => {
      hear(fleet);
      sockets.at(-1).acts.close();
      return loads;
    });
    """)
    assert counts == [0, 0, 1]


def test_a_press_holds_the_buttons_in_their_places_for_a_second_at_most() -> None:
    found = run_page("""
    const failed = STATE.vehicles.map((one) => ({ ...one, is_fresh: true, state: "failed" }));
    const isShown = () => byId("vehicles").textContent.includes("failed");
    const found = {};
    hear(FLEET);
    for (const [place, target] of [["scene", byId("scene")], ["table", byId("vehicles")]]) {
      hear(STATE);
      show();
      browser.dispatch("pointerdown", { target });
      hear({ ...STATE, vehicles: failed });
      found[place] = [1, 2, 3].map(() => (show(), isShown()));
      browser.dispatch("pointerup");
    }

    hear(STATE);
    show();
    browser.dispatch("pointerdown", { target: byId("vehicles") });
    hear({ ...STATE, vehicles: failed });
    show();
    browser.dispatch("pointerup");
    now_ms += 1;
    drawNext();
    found.released = isShown();
    """)
    assert found["scene"] == [True, True, True]
    assert found["table"] == [False, True, True]
    assert found["released"]
