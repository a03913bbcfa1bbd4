/*
 * The page of a fleet that flies.
 *
 * A socket brings the fleet once, its state ten times a second, events, and the cards of orders. The
 * page keeps the states of ten minutes, so that one can look back while the fleet flies on. Orders
 * go out as lines of the orders' grammar; the server answers each with a card. LAND ALL and HOLD ALL
 * have a lane of their own, and always mean the fleet as it is now.
 *
 * Two things are kept apart: what is seen (all vehicles, or a moment of the past) and whom the next
 * order reaches (the vehicles whose names are pressed, or all when none is).
 */
"use strict";

(() => {
  const { element, replace, table, number, clock } = Covey;
  const KEPT_S = 600;
  const MAX_EVENTS = 200;
  const MAX_ALARMS = 6;
  const SEVERITIES = ["note", "warning", "critical"]; // of alarms
  const MAX_CARDS = 8;
  const RECONNECT_MS = 1000;
  const SILENT_MS = 1500; // without a state: the page says so
  const TABLE_MS = 300; // from one table to the next: a hundred rows are more work than the scene
  const PRESS_MS = 1000; // longest time for which a press keeps buttons in their places
  const BAD_PHASES = ["refused", "failed", "timed out", "no answer"]; // of a vehicle's result
  const URGENT_KEYS = { l: "land", o: "hold" }; // with ctrl
  const REPLACED = ["alarms", "vehicles", "cards"]; // parts whose buttons are made anew

  const byId = (id) => document.getElementById(id);
  const aimed = new Set(); // names that the next order reaches; none: all
  const seen = new Map(); // alarms that somebody has acknowledged on this page -> their severity
  const cards = new Map(); // number -> card
  const states = []; // of the last ten minutes
  let fleet = null;
  let scene = null;
  let socket = null;
  let back_s = 0; // 0: now
  let lastState_ms = 0;
  let isDirty = false;
  let areTextsDirty = false;
  let isTableDirty = false;
  let lastTable_ms = 0; // when the table was shown last; 0: it is shown anew at once
  let areCardsDirty = false;
  let written = ""; // the line that was sent last, until it is refused
  let pressed_ms = -Infinity; // since when a finger or a button of the mouse is down on such a part

  // -- the socket ------------------------------------------------------------------------------------

  function connect() {
    const address = new URL("ws", location.href);
    address.protocol = "ws:";
    socket = new WebSocket(address);
    socket.addEventListener("message", (event) => take(JSON.parse(event.data)));
    socket.addEventListener("close", () => {
      showLink("bad", "no connection to covey web: what you see is old");
      setTimeout(connect, RECONNECT_MS);
    });
  }

  /* Sends a message to the server; returns whether there is a connection. */
  function say(message) {
    const isOpen = socket?.readyState === WebSocket.OPEN;
    if (isOpen) socket.send(JSON.stringify(message));
    else showLink("bad", "not sent: no connection to covey web");
    return isOpen;
  }

  function take(message) {
    if (message.kind === "fleet") begin(message);
    else if (message.kind === "state") addState(message);
    else if (message.kind === "event") addEvent(message);
    else if (message.kind === "card") addCard(message);
  }

  function begin(message) {
    const isFirst = fleet === null;
    if (!isFirst && JSON.stringify(message) !== JSON.stringify(fleet)) {
      location.reload(); // the server was started anew, for another fleet or with another fence
      return;
    }
    fleet = message;
    written = ""; // the cards that follow are no answers to it
    cards.clear();
    byId("events").replaceChildren();
    byId("lane").hidden = !fleet.can_order;
    byId("ordering").hidden = !fleet.can_order;
    if (isFirst) {
      scene = new Covey.LiveScene(byId("scene"), byId("labels"), fleet);
    }
    makeVerbs();
    showCards();
  }

  function addState(state) {
    lastState_ms = performance.now();
    if (state.time_s < states.at(-1)?.time_s) forgetStates(); // the ground's computer was restarted
    states.push(state);
    while (state.time_s - states[0].time_s > KEPT_S) states.shift();
    forgetEnded(state.alarms);
    scene.follow(state, states[0].time_s);
    showLink("good", fleet.can_order ? "live" : "live, read-only");
    isDirty = true;
  }

  function forgetStates() {
    states.length = 0;
    scene.forgetTrails();
    look(0);
  }

  // -- what is shown ---------------------------------------------------------------------------------

  /* Returns the state that is looked at: the newest, or one of the past. */
  function shown() {
    const newest = states.at(-1);
    if (!newest || back_s === 0) return newest;
    const wanted_s = newest.time_s - back_s;
    return states.findLast((state) => state.time_s <= wanted_s) ?? states[0];
  }

  /* Shows everything anew at the next picture: something else than the fleet's state has changed. */
  function showSoon() {
    isDirty = true;
    lastTable_ms = 0;
  }

  function show() {
    requestAnimationFrame(show);
    const now_ms = performance.now();
    if (lastState_ms && now_ms - lastState_ms > SILENT_MS) {
      showLink("bad", "no news for a while: what you see is old");
    }
    const state = shown();
    if (!state) return;
    const newest = states.at(-1); // orders, missions and control mean the fleet as it is now

    if (isDirty || scene.isOld) scene.draw(state, aimed, newestPreview());
    if (isDirty) {
      isDirty = false;
      areTextsDirty = true;
      isTableDirty = true;
      showTop(state);
      showTime(state, newest);
      showPresent(newest);
      showPeople(state);
    }

    // A button that is replaced between press and release is never clicked.
    if (now_ms - pressed_ms < PRESS_MS) return;
    if (areTextsDirty) {
      areTextsDirty = false;
      if (areCardsDirty) showCards();
      showAlarms(state);
      showAim(newest);
    }
    if (isTableDirty && now_ms - lastTable_ms > TABLE_MS) {
      isTableDirty = false;
      lastTable_ms = now_ms;
      showVehicles(state);
    }
  }

  function showLink(kind, text) {
    const badge = byId("link");
    badge.className = `badge ${kind}`;
    if (badge.textContent !== text) badge.textContent = text;
  }

  function showTop(state) {
    const closest = state.closest;
    const badge = byId("closest");
    badge.hidden = !closest;
    if (closest) {
      const isTooNear = Covey.areTooNear(closest, fleet);
      badge.className = `badge ${isTooNear ? "bad" : ""}`;
      const sign = isTooNear ? "too near: " : "nearest ";
      badge.textContent = `${sign}${number(closest.distance_m, 2, "m")} ${closest.first}, ${closest.second}`;
    }
  }

  /* Shows how old the shown state is, and how far one can look back. */
  function showTime(state, newest) {
    const ago = back_s ? `${clock(newest.time_s - state.time_s, 0)} ago` : "";
    byId("clock").textContent = ago;
    byId("rewind_text").textContent = ago || "now";
    byId("rewind").min = String(Math.floor(states[0].time_s - newest.time_s));
  }

  /* Shows who has control, and the mission that flies or counts down. */
  function showPresent(state) {
    const control = byId("control");
    control.hidden = !state.control;
    if (state.control) {
      control.textContent = state.control.requester
        ? `${state.control.requester} requests control: give control, or keep control`
        : state.control.text;
    }
    const mission = byId("mission");
    mission.hidden = !state.mission.line;
    byId("mission_line").textContent = state.mission.line;
    byId("stop_countdown").hidden = !state.mission.counts_down;
    byId("stop_mission").hidden = state.mission.counts_down;
  }

  /* Shows who is a person in the scene: the circle's colour, name and radius. */
  function showPeople(state) {
    const people = state.people.map((person, index) => {
      const swatch = element("i", { className: "swatch dot" });
      swatch.style.color = Covey.personColour(person);
      const radius = number(fleet.people[index].radius_m, 1, "m");
      const words = ` ${Covey.personWords(person)}: a person, circle of ${radius}`;
      return element("span", { className: "person soft" }, swatch, words);
    });
    byId("people").hidden = people.length === 0;
    replace(byId("people"), people);
  }

  function showVehicles(state) {
    const columns = [
      { title: "vehicle" },
      { title: "does" },
      { title: "nearest", isNumber: true },
      { title: "height", isNumber: true },
      { title: "battery", isNumber: true },
    ];
    const rows = state.vehicles.map((vehicle, index) => [
      nameOf(vehicle, index),
      [
        element("div", {}, vehicle.is_fresh ? stateWords(vehicle) : silence(vehicle)),
        element("div", { className: "words" }, wordsOf(vehicle)),
      ],
      vehicle.nearest ? `${number(vehicle.nearest_m, 2)} ${vehicle.nearest}` : "–",
      number(vehicle.position_enu_m?.[2], 2),
      battery(vehicle),
    ]);
    const made = table(columns, rows);
    made.querySelectorAll("tbody tr").forEach((row, index) => {
      const vehicle = state.vehicles[index];
      row.classList.toggle("aimed", aimed.has(vehicle.name));
      row.classList.toggle("silent", !vehicle.is_fresh);
    });
    keepFocus(byId("vehicles"), made);
  }

  /* Puts a table into the place of the one before; what had the focus has it again. */
  function keepFocus(parent, made) {
    const name = document.activeElement?.dataset?.vehicle;
    replace(parent, made);
    if (name) parent.querySelector(`[data-vehicle="${CSS.escape(name)}"]`)?.focus();
  }

  function nameOf(vehicle, index) {
    const swatch = element("i", { className: "swatch dot" });
    swatch.style.color = Covey.vehicleColour(index);
    const properties = {
      type: "button",
      className: "name",
      dataset: { vehicle: vehicle.name },
      "aria-pressed": String(aimed.has(vehicle.name)),
      on: { click: () => toggleAim(vehicle.name) },
    };
    return element("button", properties, swatch, vehicle.name);
  }

  function stateWords(vehicle) {
    const order = vehicle.order && vehicle.phase ? ` (${vehicle.order}: ${vehicle.phase})` : "";
    const hand = vehicle.is_flown_by_hand ? ", flown by hand" : "";
    return `${vehicle.state}${hand}${order}`;
  }

  function silence(vehicle) {
    if (vehicle.age_s === null || vehicle.age_s === undefined) return "never heard";
    return `silent for ${number(vehicle.age_s, 1, "s")}`;
  }

  function wordsOf(vehicle) {
    const words = [];
    if (vehicle.latched) words.push(vehicle.latched);
    if (vehicle.service) words.push(vehicle.service);
    if (vehicle.show) words.push(vehicle.show);
    if (vehicle.avoids) words.push(`avoids ${vehicle.avoids}`);
    if (vehicle.conditions?.length) words.push(vehicle.conditions.join(", "));
    if (vehicle.reason) words.push(vehicle.reason);
    if (vehicle.satellites) words.push(vehicle.satellites);
    return words.join(" · ");
  }

  function battery(vehicle) {
    const share = vehicle.battery_frac;
    if (share === null || share === undefined) return "–";
    const sign = share < fleet.battery_land_frac ? "✖ " : share < fleet.battery_warning_frac ? "▲ " : "";
    return `${sign}${Math.round(100 * share)} %`;
  }

  /* Forgets that alarms were acknowledged which are over: one that comes again is a new one. */
  function forgetEnded(alarms) {
    const holding = new Set(alarms.map(alarmKey));
    for (const key of seen.keys()) if (!holding.has(key)) seen.delete(key);
  }

  function showAlarms(state) {
    const open = state.alarms.filter((alarm) => !isAcknowledged(alarm));
    const acknowledged = state.alarms.filter(isAcknowledged);
    const lines = open.slice(0, MAX_ALARMS).map(alarmLine);
    const hidden = open.length - lines.length;
    if (hidden > 0) lines.push(element("div", { className: "soft" }, `and ${hidden} more`));
    if (acknowledged.length) {
      const sentences = acknowledged.map((alarm) => `✓ ${alarm.sentence}`);
      lines.push(element("div", { className: "soft" }, sentences.join(" · ")));
    }
    replaceKeepingFocus(byId("alarms"), lines);
  }

  function alarmKey(alarm) {
    return `${alarm.kind} ${alarm.subject}`;
  }

  /* An alarm that got worse has to be acknowledged again. */
  function isAcknowledged(alarm) {
    return SEVERITIES.indexOf(alarm.severity) <= SEVERITIES.indexOf(seen.get(alarmKey(alarm)));
  }

  function alarmLine(alarm) {
    const key = alarmKey(alarm);
    const acknowledge = {
      type: "button",
      className: "seen",
      dataset: { alarm: key },
      title: "acknowledge: it stays in one line until it is over",
      on: {
        click: () => {
          seen.set(key, alarm.severity);
          if (fleet.can_order) say({ do: "acknowledge", kind: alarm.kind, subject: alarm.subject });
          showSoon();
        },
      },
    };
    return element(
      "div",
      { className: `alarm ${alarm.severity}` },
      element("button", acknowledge, "✓"),
      element("strong", {}, alarm.sentence),
      ` for ${number(alarm.for_s, 0, "s")}. ${alarm.advice}`,
    );
  }

  /* Puts new lines into the place of those before; the button that had the focus has it again. */
  function replaceKeepingFocus(parent, lines) {
    const key = document.activeElement?.dataset?.alarm;
    replace(parent, lines);
    if (key) parent.querySelector(`[data-alarm="${CSS.escape(key)}"]`)?.focus();
  }

  function addEvent(event) {
    const signs = { critical: "✖ ", warning: "▲ " };
    const sentence = `${signs[event.severity] ?? ""}${event.vehicle}: ${event.sentence}`;
    const list = byId("events");
    list.prepend(element("li", { className: event.severity === "info" ? "soft" : null }, sentence));
    while (list.children.length > MAX_EVENTS) list.lastChild.remove();
  }

  // -- whom the next order reaches -------------------------------------------------------------------

  function toggleAim(name) {
    if (!aimed.delete(name)) aimed.add(name);
    showSoon();
  }

  function aimText() {
    if (!aimed.size) return "all";
    const enabled = fleet.vehicles.filter((name) => aimed.has(name));
    const disabled = [...aimed].filter((name) => !fleet.vehicles.includes(name));
    return [...enabled, ...disabled].join(",");
  }

  function showAim(state) {
    if (!fleet.can_order) return;
    byId("aim").textContent = aimText();
    const names = aimed.size ? aimed : new Set(fleet.vehicles);
    const reached = state.vehicles.filter((one) => names.has(one.name));
    const blocks = reached
      .filter((one) => one.blocks?.length && !one.is_airborne)
      .map((one) => `${one.name}: ${one.blocks[0]}`);
    if (state.control?.refusal) blocks.unshift(state.control.refusal);
    byId("blocks").textContent = blocks.slice(0, 4).join(" · ");
  }

  // -- orders ----------------------------------------------------------------------------------------

  function makeVerbs() {
    const button = (title, act) =>
      element("button", { type: "button", on: { click: act } }, title);
    const send = (verb) => () => order(`${verb} ${aimText()}`);
    const write = (text) => () => {
      byId("order_line").value = text();
      byId("order_line").focus();
    };
    const verbs = [
      button("Land", send("land")),
      button("Hold", send("hold")),
      button("Take off", () => order(`takeoff ${aimText()} 1.0`)),
      button("Move …", write(() => `move ${aimText()} 0 0 1`)),
      button("Home", send("home")),
      button("Pause show", send("pause")),
      button("Resume", send("resume")),
      button("Skip to end", send("skip")),
      button("Bring home", send("bring home")),
      button("Mission …", write(() => "mission ")),
    ];
    if (fleet.formations.length) {
      verbs.push(button("Formation …", write(() => `formation ${fleet.formations[0]} `)));
    }
    replace(byId("verbs"), verbs);
  }

  function order(text) {
    return say({ do: "order", text });
  }

  /* Sends the written line, and empties it, so that a second Enter does not send it again. */
  function sendLine() {
    const line = byId("order_line");
    const text = line.value.trim();
    if (text && !order(text)) {
      line.select();
      return;
    }
    written = text.replace(/\s+/g, " "); // as its card has it
    line.value = "";
  }

  /* Shows a refused line again, to be corrected; a kill, to be sent for the second time. */
  function takeBack() {
    const line = byId("order_line");
    if (!line.value) {
      line.value = written;
      line.select();
    }
    written = "";
  }

  function addCard(card) {
    if (card.phase === "refused" && card.text === written) takeBack();
    cards.set(card.number, card);
    areCardsDirty = true;
    showSoon();
  }

  /* Returns the newest card that waits for its confirmation. */
  function newestPreview() {
    return [...cards.values()].findLast((card) => card.phase === "previewed") ?? null;
  }

  function showCards() {
    areCardsDirty = false;
    const newest = [...cards.values()].sort((a, b) => b.number - a.number).slice(0, MAX_CARDS);
    replace(byId("cards"), newest.map(cardOf));
  }

  function cardOf(card) {
    const parts = [element("code", {}, card.text), " ", phaseBadge(card)];
    for (const sentence of card.sentences) parts.push(element("p", {}, sentence));
    for (const reason of card.reasons ?? []) parts.push(element("p", {}, `✖ ${reason}`));
    for (const figure of card.figures ?? []) {
      if (figure) parts.push(element("p", { className: "words" }, figure));
    }
    for (const result of card.results ?? []) {
      const words = `${result.vehicle} ${result.phase}. ${result.sentence}`;
      parts.push(element("p", { className: "words" }, words));
    }
    if (card.phase === "previewed") parts.push(answers(card));
    return element("article", { className: `card order ${card.phase}` }, parts);
  }

  function phaseBadge(card) {
    const phases = (card.results ?? []).map((result) => result.phase);
    const isBad = phases.some((phase) => BAD_PHASES.includes(phase));
    const isDone = phases.length > 0 && phases.every((phase) => phase === "done");
    if (card.phase === "previewed") {
      return element("span", { className: "badge" }, card.is_computing ? "flying it ahead" : "confirm?");
    }
    if (card.outcome === "passed") return element("span", { className: "badge good" }, "✔ passed");
    if (card.outcome === "failed") return element("span", { className: "badge bad" }, "✖ failed");
    if (card.phase === "refused" || isBad) return element("span", { className: "badge bad" }, "✖ not done");
    if (isDone) return element("span", { className: "badge good" }, "✔ done");
    if (card.is_final) return element("span", { className: "badge" }, "ended");
    return element("span", { className: "badge" }, card.phase === "sent" ? "under way" : card.phase);
  }

  function answers(card) {
    const confirm = {
      type: "button",
      className: "primary",
      disabled: !card.can_send,
      on: { click: () => say({ do: "confirm", number: card.number }) },
    };
    const drop = { type: "button", on: { click: () => say({ do: "drop", number: card.number }) } };
    return element(
      "p",
      {},
      element("button", confirm, "Send it"),
      " ",
      element("button", drop, "Drop it"),
    );
  }

  // -- controls --------------------------------------------------------------------------------------

  function look(seconds) {
    back_s = Math.max(0, seconds);
    byId("rewind").value = String(-back_s);
    byId("now").setAttribute("aria-pressed", String(back_s === 0));
    showSoon();
  }

  function press(event) {
    const isOnButtons = REPLACED.some((id) => byId(id).contains(event.target));
    if (isOnButtons) pressed_ms = performance.now();
  }

  /* Returns the letter of a key; where letters are not Latin, the one that the key has elsewhere. */
  function keyOf(event) {
    const isLatin = /^\p{Script=Latin}$/u.test(event.key);
    const letter = isLatin ? event.key : event.code.replace("Key", "");
    return letter.toLowerCase();
  }

  function listen() {
    byId("land_all").addEventListener("click", () => say({ do: "urgent", verb: "land" }));
    byId("hold_all").addEventListener("click", () => say({ do: "urgent", verb: "hold" }));
    byId("stop_countdown").addEventListener("click", () => say({ do: "stop_countdown" }));
    byId("stop_mission").addEventListener("click", () => order("stop"));
    byId("from_above").addEventListener("click", () => scene?.lookFromAbove());
    byId("whole").addEventListener("click", () => scene?.fit());
    byId("now").addEventListener("click", () => look(0));
    byId("rewind").addEventListener("input", (event) => look(-Number(event.target.value)));
    byId("show_ways").addEventListener("change", (event) => {
      scene.showsWays = event.target.checked;
      showSoon();
    });
    byId("order_form").addEventListener("submit", (event) => {
      event.preventDefault();
      sendLine();
    });
    document.addEventListener("keydown", (event) => {
      const verb = event.ctrlKey ? URGENT_KEYS[keyOf(event)] : null;
      if (verb && fleet?.can_order) {
        event.preventDefault();
        say({ do: "urgent", verb });
      } else if (event.key === ":" && event.target === document.body && fleet?.can_order) {
        event.preventDefault();
        byId("order_line").focus();
      }
    });
    addEventListener("pointerdown", press, true);
    for (const end of ["pointerup", "pointercancel"]) {
      addEventListener(end, () => (pressed_ms = -Infinity), true);
    }
    addEventListener("resize", () => {
      showSoon();
    });
    Covey.onThemeChange(() => {
      showSoon();
    });
  }

  listen();
  connect();
  requestAnimationFrame(show);
})();
