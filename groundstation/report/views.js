/*
 * What stands beside the scene: the verdict, tables, events, settings. Each function returns elements.
 */
"use strict";

globalThis.Covey ??= {};

(() => {
  const { element, table, number, clock } = Covey;
  const MAX_ROWS = 30;
  const SIGNS = { critical: "✗", warning: "!", info: "·", debug: "·" };

  /* Returns the name of a vehicle with its colour beside it. */
  function vehicleName(flight, vehicle) {
    const dot = element("i", { className: "swatch dot" });
    dot.style.color = Covey.vehicleColour(vehicle);
    return element("span", { className: "vehicle" }, dot, Covey.shortened(flight.names[vehicle]));
  }

  /* Returns a button that leads to a time of the flight. */
  function timeButton(app, time_s) {
    if (time_s === null || time_s === undefined || !Number.isFinite(time_s)) return "–";
    return element(
      "button",
      {
        type: "button",
        className: "time",
        title: "Show this time",
        on: { click: () => app.player.seek(time_s) },
      },
      clock(time_s),
    );
  }

  /* Returns a link to the page of a pair. */
  function pairLink(app, first, second, time_s = null) {
    const names = [first, second].map((vehicle) => app.flight.names[vehicle]);
    return element(
      "a",
      {
        href: app.address({ pair: [first, second], view: "pair", time_s }),
        on: {
          click: (event) => {
            event.preventDefault();
            if (time_s !== null) app.player.seek(time_s);
            app.showPair(first, second);
          },
        },
      },
      `${Covey.shortened(names[0])}–${Covey.shortened(names[1])}`,
    );
  }

  function badge(verdict) {
    if (verdict.passed === true) return element("span", { className: "badge good" }, "✓ passed");
    if (verdict.is_interrupted === true) {
      return element("span", { className: "badge warn" }, "! interrupted");
    }
    if (verdict.passed === false) return element("span", { className: "badge bad" }, "✗ failed");
    return element("span", { className: "badge" }, "no verdict");
  }

  // -- overview --------------------------------------------------------------------------------------

  function overview(app) {
    const { flight } = app;
    return [
      verdictCard(app),
      flight.notes.length ? notesCard(flight.notes) : null,
      factsCard(app),
      vehiclesCard(app),
      flight.pairs.length ? pairsCard(app, 8) : null,
      stepsCard(flight),
    ];
  }

  function verdictCard({ flight }) {
    const { verdict } = flight;
    const line = (className, sign, sentence) =>
      element("li", { className }, element("b", {}, sign), element("span", {}, sentence));
    const checks = list(verdict.checks).map((check) => {
      const sentence = text(check.sentence);
      if (check.has_come_true !== true) return line("bad", "✗", sentence);
      // down, but by a fall
      if (check.name === "all_landed" && flight.falls.length) return line("warn", "!", sentence);
      return line("good", "✓", sentence);
    });
    checks.push(...flight.falls.map((sentence) => line("bad", "✗", sentence)));
    const unknown = list(verdict.unknown_times).length;
    return element(
      "section",
      { className: "card verdict" },
      element("header", {}, element("h2", {}, "Verdict"), badge(verdict)),
      element("p", {}, text(verdict.summary) || "Nothing was declared about this flight."),
      checks.length ? element("ul", { className: "checks" }, checks) : null,
      unknown
        ? element("p", { className: "soft" }, `${unknown} times in which nobody saw a distance.`)
        : null,
    );
  }

  function notesCard(notes) {
    return element(
      "section",
      { className: "card notes" },
      element("h2", {}, "About this record"),
      element("ul", {}, notes.map((note) => element("li", {}, note))),
    );
  }

  function factsCard(app) {
    const { flight } = app;
    const [nearest] = flight.pairs;
    const laws = [...new Set(flight.vehicles.map((vehicle) => vehicle.law).filter(Boolean))];
    const facts = [
      ["Mission", text(flight.verdict.mission) || "–"],
      ["Fleet", flight.fleet?.name ?? "–"],
      ["Law", laws.join(", ") || flight.fleet?.law || "–"],
      ["Vehicles", String(flight.names.length)],
      ["Length", clock(flight.end_s - flight.begin_s)],
      ["Promised", number(flight.promise_m, 2, "m")],
      [
        "Closest",
        nearest
          ? [number(nearest[2], 2, "m"), " ", pairLink(app, nearest[0], nearest[1], nearest[3])]
          : "–",
      ],
      ["Distances by", flight.has_truth ? "ground truth" : "the vehicles' own estimates"],
    ];
    return element(
      "dl",
      { className: "facts" },
      facts.map(([name, value]) =>
        element("div", {}, element("dt", {}, name), element("dd", {}, value)),
      ),
    );
  }

  function vehiclesCard(app) {
    const { flight } = app;
    const rows = flight.names.map((_, vehicle) => {
      const battery = known(flight.curve(vehicle, "battery"));
      const intervention = flight.curve(vehicle, "intervention");
      const touched = intervention.filter((value) => value > 0.05).length;
      const seen = known(intervention).length;
      return [
        element(
          "button",
          {
            type: "button",
            className: "plain",
            title: "Follow it",
            on: { click: () => app.follow(vehicle) },
          },
          vehicleName(flight, vehicle),
          flight.vehicles[vehicle].is_collided ? element("b", { className: "bad" }, " ✗ collided") : null,
        ),
        battery.length
          ? `${(100 * battery[0]).toFixed(0)} → ${(100 * Covey.smallest(battery)).toFixed(0)} %`
          : "–",
        number(largest(intervention), 1, "m/s²"),
        seen ? `${((100 * touched) / seen).toFixed(0)} %` : "–",
        number(1000 * largest(flight.curve(vehicle, "period")), 0, "ms"),
        number(1000 * largest(flight.curve(vehicle, "neighbour_age")), 0, "ms"),
      ];
    });
    const columns = [
      { title: "Vehicle" },
      { title: "Battery", isNumber: true },
      { title: "Law, most", isNumber: true },
      { title: "Law acts", isNumber: true },
      { title: "Period", isNumber: true },
      { title: "Neighbour's age", isNumber: true },
    ];
    return element(
      "section",
      { className: "card" },
      element("h2", {}, "Vehicles"),
      table(columns, rows),
      element(
        "p",
        { className: "soft" },
        "Battery: at first, and its least. The law: its largest change of the thrust, and how long it changed it.",
        " Period of the loop (nominal 20 ms) and age of the neighbour that was silent for longest: the largest of the flight.",
      ),
    );
  }

  function pairsCard(app, most) {
    const { flight } = app;
    const promise_m = flight.promise_m;
    const rows = flight.pairs.slice(0, most).map(([first, second, distance_m, time_s]) => {
      const isBelow = promise_m !== null && distance_m < promise_m;
      return [
        pairLink(app, first, second, time_s),
        element(
          "span",
          { className: isBelow ? "bad" : null },
          `${isBelow ? "✗ " : ""}${number(distance_m, 3, "m")}`,
        ),
        promise_m === null ? "–" : number(distance_m - promise_m, 3, "m"),
        timeButton(app, time_s),
      ];
    });
    const columns = [
      { title: "Pair" },
      { title: "Smallest distance", isNumber: true },
      { title: "Beyond the promise", isNumber: true },
      { title: "At", isNumber: true },
    ];
    const more = flight.pairs.length - rows.length;
    return element(
      "section",
      { className: "card" },
      element("h2", {}, "Nearest pairs"),
      table(columns, rows),
      more > 0 ? element("p", { className: "soft" }, `${more} pairs stayed further apart.`) : null,
    );
  }

  function stepsCard(flight) {
    const steps = list(flight.verdict.steps);
    if (!steps.length) return null;
    const rows = steps.slice(0, 200).map((step) => {
      const phases = Object.entries(step.vehicles ?? {});
      const others = phases.filter(([, phase]) => phase !== "done");
      const outcome = others.length
        ? others.map(([name, phase]) => `${name}: ${phase}`).join(", ")
        : "✓ done by all";
      return [text(step.step), number(step.duration_s, 1, "s"), outcome];
    });
    const columns = [{ title: "Step" }, { title: "Took", isNumber: true }, { title: "Outcome" }];
    return element(
      "section",
      { className: "card" },
      element("h2", {}, "Steps"),
      table(columns, rows),
    );
  }

  // -- events ----------------------------------------------------------------------------------------

  /* Returns events and orders by time: {time_s, vehicle, severity, text, result}. */
  function story(flight) {
    const rows = flight.events.map(([time_s, vehicle, severity, code, sentence]) => ({
      time_s,
      vehicle,
      severity,
      code,
      text: sentence,
      result: "",
    }));
    for (const order of flight.orders) {
      rows.push({
        time_s: order.at_s,
        vehicle: order.vehicle,
        severity: order.answer.startsWith("refused") ? "warning" : "info",
        code: "order given",
        text: order.text,
        result: [order.answer, order.end].filter(Boolean).join("; "),
        isOrder: true,
      });
    }
    rows.sort((a, b) => a.time_s - b.time_s);
    return rows;
  }

  /* Returns the list of events and orders; rows are marked as the flight goes on. */
  function events(app, names = null) {
    const frame = element("ol", { className: "story" });
    const search = element("input", {
      type: "search",
      placeholder: "Search",
      "aria-label": "Search events and orders",
    });
    const withDetails = element("input", { type: "checkbox", id: "details" });
    const rows = story(app.flight).filter((row) => !names || names.includes(row.vehicle));
    let shown = [];

    const fill = () => {
      const words = search.value.toLowerCase();
      shown = rows.filter((row) => {
        if (row.severity === "debug" && !withDetails.checked) return false;
        return `${row.vehicle} ${row.code} ${row.text} ${row.result}`.toLowerCase().includes(words);
      });
      Covey.replace(
        frame,
        shown.length ? shown.map((row) => storyRow(app, row)) : element("li", {}, "Nothing."),
      );
      mark();
    };

    const mark = () => {
      const time_s = app.player.time_s + 1e-6;
      shown.forEach((row, index) => {
        frame.children[index].classList.toggle("past", row.time_s <= time_s);
      });
    };

    search.addEventListener("input", fill);
    withDetails.addEventListener("change", fill);
    fill();
    return {
      elements: [
        element(
          "div",
          { className: "story-tools" },
          search,
          element("label", {}, withDetails, " with details"),
        ),
        frame,
      ],
      onTime: mark,
    };
  }

  function storyRow(app, row) {
    const vehicle = app.flight.names.indexOf(row.vehicle);
    return element(
      "li",
      { className: row.isOrder ? `order ${row.severity}` : row.severity },
      timeButton(app, row.time_s),
      element("b", { className: "sign", title: row.severity }, row.isOrder ? "→" : SIGNS[row.severity] ?? "·"),
      element(
        "span",
        { className: "who" },
        vehicle >= 0 ? vehicleName(app.flight, vehicle) : Covey.shortened(row.vehicle),
      ),
      element(
        "span",
        { className: "what", title: row.code },
        row.text,
        row.result ? element("span", { className: "result" }, row.result) : null,
      ),
    );
  }

  // -- the setup -------------------------------------------------------------------------------------

  function setup(app) {
    const { flight } = app;
    const chosen = flight.settings.filter(([, , , , isChosen]) => isChosen);
    const columns = [
      { title: "Key" },
      { title: "Value" },
      { title: "Default" },
      { title: "Of" },
    ];
    const rowsOf = (settings) =>
      settings.map(([where, key, value, standard, isChosen, vehicles]) => [
        element("span", {}, element("span", { className: "soft" }, `${where}.`), key),
        isChosen ? element("b", {}, value) : value,
        standard || "–",
        vehicles || (where === "vehicles" ? "all" : ""),
      ]);

    return [
      element(
        "section",
        { className: "card" },
        element("h2", {}, "Versions"),
        table([{ title: "What" }, { title: "Version" }], [
          ...flight.versions,
          ["this page", flight.made_by],
        ]),
      ),
      element(
        "section",
        { className: "card" },
        element("h2", {}, "What differs from the defaults"),
        chosen.length
          ? table(columns, rowsOf(chosen))
          : element("p", { className: "soft" }, "Nothing that the record knows of."),
      ),
      flight.settings.length
        ? element(
            "details",
            { className: "card" },
            element("summary", {}, `All ${flight.settings.length} values of the fleet file`),
            table(columns, rowsOf(flight.settings)),
          )
        : null,
      flight.mission
        ? element(
            "details",
            { className: "card" },
            element("summary", {}, "The mission file"),
            element("pre", {}, flight.mission),
          )
        : null,
    ];
  }

  // -- PX4's own log ---------------------------------------------------------------------------------

  /* Returns what PX4 said in its own log, and how its times were found. */
  function px4(app, vehicles) {
    const { flight } = app;
    if (!flight.px4.length) {
      const sentence = "No log of PX4 is beside the record: covey log fetch brings them.";
      return [element("p", { className: "missing" }, sentence)];
    }
    return flight.px4.filter((one) => vehicles.includes(one.vehicle)).flatMap((one) => {
      const said = [
        ...one.modes.map(([time_s, mode]) => [time_s, "mode", mode]),
        ...one.texts,
      ].sort((first, second) => first[0] - second[0]);
      const place = one.place_m === null ? "" : `, its places by ${one.place_m.toFixed(2)} m`;
      return [
        element(
          "section",
          { className: "card" },
          element("h2", {}, vehicleName(flight, one.vehicle), " in PX4's own words"),
          element(
            "p",
            { className: "soft" },
            `${one.file}: put on this clock by roll and pitch, which differ by ` +
              `${one.residual_deg.toFixed(2)}° (standard deviation)${place}. ` +
              one.about.map(([key, value]) => `${key} ${value}`).join(", "),
          ),
          table(
            [{ title: "Time" }, { title: "Level" }, { title: "What" }],
            said.map(([time_s, level, words]) => [timeButton(app, time_s), level, words]),
          ),
        ),
      ];
    });
  }

  // -- small things ----------------------------------------------------------------------------------

  function known(values) {
    return values.filter((value) => !Number.isNaN(value));
  }

  function largest(values) {
    let most = NaN;
    for (const value of values) {
      if (!(value <= most) && !Number.isNaN(value)) most = value;
    }
    return most;
  }

  /* What a verdict file has may have been written by anybody: lists and texts are made sure of. */
  function list(value) {
    return Array.isArray(value) ? value.filter((one) => one && typeof one === "object") : [];
  }

  function text(value) {
    return typeof value === "string" ? value : "";
  }

  Covey.views = { overview, events, setup, px4, pairsCard, pairLink, story, badge, vehicleName, MAX_ROWS };
})();
