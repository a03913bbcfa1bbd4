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


def test_a_line_that_is_refused_or_not_sent_comes_back_and_so_does_a_kill() -> None:
    found = run_page("""
    const line = byId("order_line");
    const found = {};
    hear(FLEET);
    const enter = () => byId("order_form").dispatch("submit");
    const answer = (number, text, phase) => {
      hear({ kind: "card", number, text, phase, sentences: [], outcome: "" });
      return line.value;
    };

    line.value = " kill  mav1";
    enter();
    found.first = [line.value, answer(1, "kill mav1", "refused")];
    enter();
    found.second = [line.value, answer(2, "kill mav1", "sent")];
    found.orders = sent.map((message) => message.text);

    line.value = "mission none.toml";
    enter();
    found.refused_later = [
      answer(3, "mission none.toml", "sent"), answer(3, "mission none.toml", "refused"),
    ];
    line.value = "lnd all";
    enter();
    line.value = "land all";
    found.typed_meanwhile = answer(4, "lnd all", "refused");
    line.value = "";
    found.of_another_page = answer(5, "lnd all", "refused");

    line.value = "land all";
    sockets.at(-1).readyState = 3;
    enter();
    found.without_connection = [line.value, sent.at(-1).text];
    """)
    assert found["first"] == ["", "kill mav1"]
    assert found["second"] == ["", ""]
    assert found["orders"] == ["kill  mav1", "kill mav1"]
    assert found["refused_later"] == ["", "mission none.toml"]
    assert found["typed_meanwhile"] == "land all"
    assert found["of_another_page"] == ""
    assert found["without_connection"] == ["land all", "lnd all"]


def test_a_card_says_how_its_order_ended() -> None:
    said = run_page("""
    const badge = (changes) => {
      hear({ kind: "card", number: 1, text: "x", phase: "sent", sentences: [], ...changes });
      show();
      return byId("cards").children[0].children[2].textContent;
    };
    const result = (phase) => ({ vehicle: "v000", phase, sentence: "" });
    hear(FLEET);
    hear(STATE);
    const found = [
      ["done"], ["timed out"], ["no answer"], ["done", "superseded"], ["cancelled"],
    ].map((phases) => badge({ is_final: true, results: phases.map(result) }));
    found.push(badge({ is_final: false, results: ["done", "accepted"].map(result) }));
    found.push(badge({}), badge({ phase: "answered" }));
    """)
    assert said[:3] == ["✔ done", "✖ not done", "✖ not done"]
    assert said[3:5] == ["ended", "ended"]
    assert said[5:] == ["under way", "under way", "answered"]


def test_ctrl_l_and_ctrl_o_reach_all_on_every_layout_of_keys() -> None:
    verbs = run_page("""
    hear(FLEET);
    const found = [
      ["l", "KeyL"], ["O", "KeyO"], // Latin
      ["д", "KeyL"], ["щ", "KeyO"], // Russian
      ["n", "KeyL"], ["l", "KeyP"], // Dvorak
      ["ł", "KeyL"], ["Control", "ControlLeft"], ["5", "Digit5"],
    ].map(([key, code]) => {
      sent.length = 0;
      document.dispatch("keydown", { ctrlKey: true, key, code });
      document.dispatch("keydown", { ctrlKey: false, key, code });
      return sent.map((message) => message.verb).join();
    });
    """)
    assert verbs == ["land", "hold", "land", "hold", "", "land", "", "", ""]


def test_who_looks_back_sees_the_countdown_the_control_and_the_refusals_of_now() -> None:
    found = run_page("""
    const later = (seconds, changes) => ({ ...STATE, time_s: STATE.time_s + seconds, ...changes });
    hear(FLEET);
    hear(STATE);
    hear(later(20));
    byId("rewind").dispatch("input", { target: { value: "-20" } });
    show();
    hear(later(21, {
      mission: { line: "show.toml starts in 20 s", counts_down: true },
      control: { text: "lab-2 has control", refusal: "lab-2 has control.", requester: "lab-2" },
      vehicles: STATE.vehicles.map((one) => ({ ...one, blocks: ["no position"] })),
    }));
    show();
    const shown = (id) => !byId(id).hidden && byId(id).textContent;
    const found = ["mission_line", "control", "blocks"].map(shown);
    found.push(byId("mission").hidden, byId("stop_countdown").hidden);
    """)
    mission_line, control, blocks, is_mission_hidden, is_stop_hidden = found
    assert mission_line == "show.toml starts in 20 s"
    assert control.startswith("lab-2 requests control")
    assert blocks.startswith("lab-2 has control. · v000: no position")
    assert not is_mission_hidden
    assert not is_stop_hidden


def test_two_that_stand_near_each_other_on_the_ground_are_not_too_near() -> None:
    found = run_page("""
    const closest = { first: "v000", second: "v001", distance_m: 0.5, is_truth: false };
    const position = { is_fresh: true, way_enu_m: [], position_enu_m: [0, 0, 0] };
    const vehicles = STATE.vehicles.map((one) => ({ ...one, ...position }));
    hear(FLEET);
    const found = [false, true].map((is_flying) => {
      hear({ ...STATE, vehicles, closest: { ...closest, is_flying } });
      show();
      return [byId("closest").textContent, byId("closest").className, lines.at(-1)[2].width];
    });
    """)
    assert found == [
        ["nearest 0.50 m v000, v001", "badge ", 1],
        ["too near: 0.50 m v000, v001", "badge bad", 3],
    ]


def test_a_vehicle_without_a_known_position_is_drawn_pale_where_it_was_last() -> None:
    found = run_page("""
    const drawn = [];
    Covey.Scene.prototype.body = (position, quaternion, colour, { opacity }) => {
      drawn.push([position, opacity]);
    };
    Covey.Scene.prototype.label = (position, text) => drawn.push([position, text]);
    const vehicle = { ...STATE.vehicles[0], last_enu_m: [1, 2, 1] };
    const known = { ...vehicle, is_fresh: true, position_enu_m: [1, 2, 1], way_enu_m: [] };
    hear(FLEET);
    const found = [
      known, { ...known, position_enu_m: null }, vehicle, { ...vehicle, last_enu_m: null },
    ].map((one) => {
      drawn.length = 0;
      hear({ ...STATE, vehicles: [one] });
      show();
      return [...drawn];
    });
    """)
    place = [1, 2, 1]
    assert found[0] == [[place, 1], [place, "v000"]]
    assert found[1] == [[place, 0.4], [place, "v000, no position"]]
    assert found[2] == [[place, 0.4], [place, "v000, silent"]]
    assert found[3] == [], "it was never seen"


def test_an_order_reaches_a_vehicle_that_the_fleet_file_disables_by_its_name_only() -> None:
    found = run_page("""
    const spare = { ...STATE.vehicles[0], name: "spare", blocks: ["disabled"] };
    hear(FLEET);
    hear({ ...STATE, vehicles: [...STATE.vehicles, spare] });
    show();
    const names = [];
    const collect = (node) => {
      if (node.dataset.vehicle) names.push(node);
      node.children.forEach(collect);
    };
    collect(byId("vehicles"));
    const aim = () => (show(), [byId("aim").textContent, byId("blocks").textContent]);
    const found = [aim()];
    names.at(-1).dispatch("click");
    found.push(aim());
    names[0].dispatch("click");
    found.push(aim());
    """)
    assert found == [["all", ""], ["spare", "spare: disabled"], ["v000,spare", "spare: disabled"]]


def test_the_row_of_a_killed_vehicle_says_that_it_gets_no_orders() -> None:
    row = run_page("""
    const latched = "v000 was killed. Look at it, then write: reset v000";
    const killed = { ...STATE.vehicles[0], is_fresh: true, state: "ready", latched };
    hear(FLEET);
    hear({ ...STATE, vehicles: [killed] });
    show();
    const found = byId("vehicles").textContent;
    """)
    assert "readyv000 was killed. Look at it, then write: reset v000" in row


def test_an_acknowledged_alarm_that_ends_and_comes_again_on_a_hidden_page_is_a_new_one() -> None:
    found = run_page("""
    const alarm = {
      kind: "battery low", subject: "v000", severity: "critical", sentence: "v000: battery low",
      advice: "Land it.", for_s: 1, count: 1,
    };
    const told = (alarms) => (hear({ ...STATE, alarms }), show(), byId("alarms").textContent);
    hear(FLEET);
    told([alarm]);
    byId("alarms").children[0].children[0].dispatch("click");
    const found = [told([alarm])];
    hear(STATE); // a hidden page shows nothing
    found.push(told([alarm]), ...sent);
    """)
    acknowledged, anew, said = found
    assert acknowledged == "✓ v000: battery low"
    assert anew == "✓v000: battery low for 1 s. Land it."
    assert said == {"do": "acknowledge", "kind": "battery low", "subject": "v000"}


def test_an_acknowledged_alarm_that_gets_worse_is_shown_as_a_new_one() -> None:
    found = run_page("""
    const alarm = {
      kind: "battery", subject: "v000", severity: "warning", sentence: "v000: battery at 28 %",
      advice: "Land soon.", for_s: 1, count: 1,
    };
    const told = (severity) => {
      hear({ ...STATE, alarms: [{ ...alarm, severity }] });
      show();
      return byId("alarms").children[0].className;
    };
    hear(FLEET);
    const found = [told("warning")];
    byId("alarms").children[0].children[0].dispatch("click");
    found.push(told("warning"), told("note"), told("critical"));
    """)
    assert found == ["alarm warning", "soft", "soft", "alarm critical"]


def test_who_looks_back_sees_the_trail_of_that_moment() -> None:
    found = run_page("""
    const vehicle = {
      ...STATE.vehicles[0], is_fresh: true, way_enu_m: [], goal_enu_m: null, blocks: [],
    };
    hear(FLEET);
    for (let second = 0; second <= 60; second += 1) {
      const vehicles = [{ ...vehicle, position_enu_m: [0.1 * second, 0, 1] }];
      hear({ ...STATE, time_s: second, vehicles });
    }
    const found = [0, -20, -58].map((back) => {
      byId("rewind").dispatch("input", { target: { value: String(back) } });
      show();
      const trail = lines.filter(([, , look]) => look.width === 2);
      const seconds = trail.flatMap(([begin, end]) => [10 * begin[0], 10 * end[0]]);
      return [Math.min(...seconds), Math.max(...seconds)].map(Math.round);
    });
    """)
    assert found == [[48, 60], [28, 40], [0, 2]]


def test_a_page_that_is_open_over_a_restart_of_the_computer_begins_anew() -> None:
    found = run_page("""
    const vehicle = { ...STATE.vehicles[0], is_fresh: true, way_enu_m: [] };
    const hearSecond = (time_s, east_m) => {
      hear({ ...STATE, time_s, vehicles: [{ ...vehicle, position_enu_m: [east_m, 0, 1] }] });
    };
    hear(FLEET);
    for (let second = 0; second <= 20; second += 1) hearSecond(90000 + second, second);
    byId("rewind").dispatch("input", { target: { value: "-5" } });
    for (let second = 0; second <= 4; second += 1) hearSecond(100 + second, 50 + second);
    show();
    const trail = lines.filter(([, , look]) => look.width === 2);
    const found = [trail[0][0][0], trail.length];
    found.push(byId("rewind").min, byId("rewind_text").textContent);
    """)
    assert found == [50, 5, "-4", "now"]


def test_the_page_says_how_old_the_state_is_that_it_shows() -> None:
    found = run_page("""
    const look = (back) => {
      byId("rewind").dispatch("input", { target: { value: String(back) } });
      show();
      return [byId("rewind_text").textContent, byId("clock").textContent];
    };
    hear(FLEET);
    for (const time_s of [0, 10, 30.5]) hear({ ...STATE, time_s });
    const found = [look(0), look(-600), look(-15), byId("rewind").min];
    """)
    oldest, before_a_gap = ["0:31 ago"] * 2, ["0:21 ago"] * 2
    assert found == [["now", ""], oldest, before_a_gap, "-31"]
