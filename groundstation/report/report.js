/*
 * A report: the scene, the time line below it, and the pages beside it.
 *
 * The address says what is shown: report.html#t=12.5&pair=mav0-mav3 opens the page of that pair at
 * that second. It follows what is chosen, so that it can be copied at any time.
 */
"use strict";

globalThis.Covey ??= {};

(() => {
  const { element, clock } = Covey;
  const VIEWS = [
    ["overview", "Overview"],
    ["distances", "Distances"],
    ["pair", "Pair"],
    ["law", "Law"],
    ["motion", "Motion"],
    ["air", "Wind & battery"],
    ["loop", "Loop & bus"],
    ["events", "Events & orders"],
    ["setup", "Setup"],
    ["px4", "PX4"],
  ];
  const WITH_VEHICLES = new Set(["law", "motion", "air", "loop", "px4"]);
  const PER_VEHICLE_LIMIT = { law: 2, motion: 2, air: 8, loop: 8, px4: 1 }; // chosen at first
  const JUMP_S = 5;
  const STEP_S = 0.1;
  const SUBTITLE_S = 4;
  const KEYS = [
    ["space", "play, pause; from the end begin again"],
    [", .", "0.1 s back, on"],
    ["← →", "5 s back, on"],
    ["n N", "to the next event, to the one before"],
    ["< >", "slower, faster"],
    ["home end", "begin, end"],
    ["f F", "follow the next vehicle, nobody"],
    ["p", "the page of the pair that is nearest now"],
    ["t", "look from above, and back"],
    ["r", "show everything"],
    ["+ −", "nearer, further"],
    ["1 … 9, 0", "the pages"],
    ["?", "these keys"],
  ];

  class Report {
    constructor(flight, parent) {
      this.flight = flight;
      this.player = new Covey.Player(flight.begin_s, flight.end_s);
      this.view = "overview";
      this.pair = flight.pairs.length ? flight.pairs[0].slice(0, 2) : firstPair(flight);
      this.chosen = new Map(); // view -> numbers of vehicles
      this.charts = new Covey.ChartGroup({ onSeek: (time_s) => this.player.seek(time_s) });
      this._story = Covey.views.story(flight).filter((row) => row.severity !== "debug");
      this._onTime = null; // of the page beside the scene
      this._wasAbove = null; // angles of the camera before it looked from above

      this._build(parent);
      this.flightScene = new Covey.FlightScene(flight, this._canvas, this._labels, () =>
        this.player.draw(),
      );
      this.flightScene.fit();
      this._listen();
      this._readAddress();
      this._showView();
      this.player.onPicture(() => this._draw());
      this.player.draw();
    }

    // -- building --------------------------------------------------------------------------------------

    _build(parent) {
      const { flight } = this;
      document.title = `${flight.title} - Covey`;
      Covey.replace(parent, this._top(), this._main(), this._transport(), this._help());
    }

    _top() {
      const { flight } = this;
      const subtitle = [flight.fleet?.name, flight.verdict.mission].filter(
        (one) => typeof one === "string",
      );
      this._tabs = VIEWS.map(([name, title]) =>
        element(
          "button",
          {
            type: "button",
            role: "tab",
            id: `tab-${name}`,
            on: { click: () => this.show(name) },
          },
          title,
        ),
      );
      return element(
        "header",
        { className: "top" },
        element(
          "div",
          { className: "title" },
          element("h1", {}, flight.title),
          element("span", { className: "soft" }, [...new Set(subtitle)].join(" · ")),
          Covey.views.badge(flight.verdict),
        ),
        element("nav", { role: "tablist", "aria-label": "Pages" }, this._tabs),
      );
    }

    _main() {
      this._canvas = element("canvas", {
        tabindex: "0",
        "aria-label": "The flight in three dimensions",
      });
      this._labels = element("canvas", { className: "labels", "aria-hidden": "true" });
      this._clock = element("div", { className: "clock" });
      this._nearest = element("div", { className: "nearest" });
      this._subtitle = element("div", { className: "subtitle", "aria-live": "polite" });
      this._content = element("div", { className: "content", role: "tabpanel" });
      return element(
        "main",
        {},
        element(
          "section",
          { className: "scene" },
          this._canvas,
          this._labels,
          element("div", { className: "hud" }, this._clock, this._nearest),
          this._layers(),
          this._subtitle,
        ),
        this._content,
      );
    }

    /* Returns the list of what the scene shows. */
    _layers() {
      const isThere = { ghost: Boolean(this.flight.ghost), px4: this.flight.px4.length > 0 };
      const boxes = Covey.LAYERS.filter(([name]) => isThere[name] ?? true).map(
        ([name, title, isOn]) => {
          const box = element("input", { type: "checkbox", checked: isOn });
          box.addEventListener("change", () => {
            this.flightScene.layers[name] = box.checked;
            this.player.draw();
          });
          const words = name === "ghost" ? `${title}: ${this.flight.ghost}` : title;
          return element("label", {}, box, words);
        },
      );
      const button = (title, words, action) =>
        element("button", { type: "button", title, on: { click: action } }, words);
      return element(
        "div",
        { className: "tools" },
        button("Look from above (t)", "Above", () => this.lookFromAbove()),
        button("Show everything (r)", "All", () => this.showAll()),
        element(
          "details",
          {},
          element("summary", { title: "What the scene shows" }, "Show"),
          element("div", { className: "layers" }, boxes),
        ),
      );
    }

    _transport() {
      const { flight, player } = this;
      this._play = element(
        "button",
        { type: "button", className: "primary play", on: { click: () => player.toggle() } },
        "▶",
      );
      this._slider = element("input", {
        type: "range",
        min: flight.begin_s,
        max: flight.end_s,
        step: "any",
        value: flight.begin_s,
        "aria-label": "Time of the flight",
      });
      this._slider.addEventListener("input", () => player.seek(Number(this._slider.value)));
      this._lane = element("canvas", { className: "lane", "aria-hidden": "true" });

      this._speed = element(
        "select",
        { "aria-label": "Speed" },
        Covey.SPEEDS.map((speed) => element("option", { value: speed }, `${speed}×`)),
      );
      this._speed.value = "1";
      this._speed.addEventListener("change", () => player.setSpeed(Number(this._speed.value)));

      this._follow = element(
        "select",
        { "aria-label": "Follow" },
        element("option", { value: "" }, "Follow nobody"),
        flight.names.map((name, vehicle) =>
          element("option", { value: vehicle }, `Follow ${Covey.shortened(name)}`),
        ),
      );
      this._follow.addEventListener("change", () => {
        this.follow(this._follow.value === "" ? null : Number(this._follow.value));
      });

      this._time = element("span", { className: "time-text" });
      return element(
        "footer",
        { className: "transport" },
        this._play,
        element("div", { className: "track" }, this._lane, this._slider),
        this._time,
        this._speed,
        this._follow,
        element(
          "button",
          { type: "button", title: "Keys (?)", on: { click: () => this._dialog.showModal() } },
          "?",
        ),
      );
    }

    _help() {
      const rows = KEYS.map(([key, what]) => [element("kbd", {}, key), what]);
      this._dialog = element(
        "dialog",
        {},
        element("h2", {}, "Keys"),
        Covey.table([{ title: "Key" }, { title: "What it does" }], rows),
        element("p", { className: "soft" }, "Click in a curve: show that time. Drag: look closer. Twice: all of it."),
        element(
          "form",
          { method: "dialog" },
          element("button", { className: "primary" }, "Close"),
        ),
      );
      return this._dialog;
    }

    // -- what is shown ---------------------------------------------------------------------------------

    /* Shows one of the pages beside the scene. */
    show(view) {
      this.view = view;
      this._showView();
      this._writeAddress();
    }

    showPair(first, second) {
      this.pair = [first, second];
      this.flightScene.pair = this.pair;
      this.show("pair");
    }

    follow(vehicle) {
      this.flightScene.followed = vehicle;
      if (vehicle === null) this.flightScene.fit();
      else this.flightScene.scene.camera.distance_m = Math.min(this.flightScene.scene.camera.distance_m, 6);
      this._follow.value = vehicle === null ? "" : String(vehicle);
      this._writeAddress();
      this.player.draw();
    }

    showAll() {
      this.flightScene.followed = null;
      this._follow.value = "";
      this.flightScene.fit();
      this.player.draw();
    }

    /* Looks from above; from there back to where one looked before. */
    lookFromAbove() {
      const camera = this.flightScene.scene.camera;
      if (this._wasAbove) {
        [camera.azimuth_rad, camera.elevation_rad] = this._wasAbove;
        this._wasAbove = null;
      } else {
        this._wasAbove = [camera.azimuth_rad, camera.elevation_rad];
        camera.lookFromAbove();
      }
      this.player.draw();
    }

    _showView() {
      VIEWS.forEach(([name], index) => {
        const isShown = name === this.view;
        this._tabs[index].setAttribute("aria-selected", String(isShown));
        if (isShown) this._tabs[index].scrollIntoView({ block: "nearest", inline: "nearest" });
      });
      this.charts.clear();
      this._onTime = null;
      this._content.replaceChildren();
      this._content.scrollTop = 0;
      this._content.dataset.view = this.view;
      this.flightScene.pair = this.view === "pair" ? this.pair : null;

      if (this.view === "overview") Covey.replace(this._content, Covey.views.overview(this));
      else if (this.view === "setup") Covey.replace(this._content, Covey.views.setup(this));
      else if (this.view === "events") this._showEvents();
      else if (this.view === "pair") this._showPairView();
      else this._showCharts();
      this.charts.setTime(this.player.time_s);
      this.player.draw();
    }

    _showEvents(names = null) {
      const events = Covey.views.events(this, names);
      this._content.append(...events.elements);
      this._onTime = events.onTime;
    }

    _showCharts() {
      if (WITH_VEHICLES.has(this.view)) this._content.append(this._vehicleChips());
      const grid = element("div", { className: "charts" });
      this._content.append(grid);
      Covey.flightCharts[this.view](this._chartView(), grid);
      if (this.view === "px4") this._content.append(...Covey.views.px4(this, this._chosenVehicles()));
      if (this.view === "distances" && this.flight.pairs.length) {
        this._content.append(Covey.views.pairsCard(this, Covey.views.MAX_ROWS));
      }
    }

    _chartView() {
      return {
        flight: this.flight,
        charts: this.charts,
        chosen: this._chosenVehicles(),
        marks: this._marks(),
      };
    }

    _marks() {
      return this._story.map((row) => ({ time_s: row.time_s, colour: Covey.colour(rowColour(row)) }));
    }

    /* Returns the vehicles whose curves are shown: at first those of the nearest pair. */
    _chosenVehicles() {
      if (!this.chosen.has(this.view)) {
        const all = this.flight.names.map((_, vehicle) => vehicle);
        const limit = PER_VEHICLE_LIMIT[this.view] ?? 8;
        const first = this.pair && limit < all.length ? this.pair : [];
        const rest = all.filter((vehicle) => !first.includes(vehicle));
        this.chosen.set(this.view, [...first, ...rest].slice(0, limit).sort((a, b) => a - b));
      }
      return this.chosen.get(this.view);
    }

    _vehicleChips() {
      const chosen = this._chosenVehicles();
      const all = this.flight.names.map((_, vehicle) => vehicle);
      const choose = (vehicles) => {
        this.chosen.set(this.view, vehicles);
        const top = this._content.scrollTop;
        this._showView();
        this._content.scrollTop = top;
      };
      const chips = all.map((vehicle) => {
        const isChosen = chosen.includes(vehicle);
        const others = chosen.filter((one) => one !== vehicle);
        return element(
          "button",
          {
            type: "button",
            "aria-pressed": String(isChosen),
            on: {
              click: () =>
                choose(isChosen ? others : [...chosen, vehicle].sort((a, b) => a - b)),
            },
          },
          Covey.views.vehicleName(this.flight, vehicle),
        );
      });
      const everybody = element(
        "button",
        { type: "button", on: { click: () => choose(chosen.length < all.length ? all : []) } },
        chosen.length < all.length ? "All" : "None",
      );
      return element("div", { className: "chips" }, chips, everybody);
    }

    _showPairView() {
      const { flight } = this;
      if (!this.pair) {
        this._content.append(element("p", { className: "missing" }, "One vehicle is no pair."));
        return;
      }
      const [first, second] = this.pair;
      const choice = (which) => {
        const list = element(
          "select",
          { "aria-label": which ? "Second vehicle" : "First vehicle" },
          flight.names.map((name, vehicle) =>
            element(
              "option",
              { value: vehicle, disabled: vehicle === this.pair[1 - which] },
              Covey.shortened(name),
            ),
          ),
        );
        list.value = String(this.pair[which]);
        list.addEventListener("change", () => {
          const pair = [...this.pair];
          pair[which] = Number(list.value);
          this.showPair(...pair);
        });
        return list;
      };

      const row = flight.pairs.find(([a, b]) => this.pair.includes(a) && this.pair.includes(b));
      const grid = element("div", { className: "charts" });
      this._content.append(
        element(
          "div",
          { className: "pair-choice" },
          choice(0),
          element("span", {}, "and"),
          choice(1),
          row ? this._pairWords(row) : element("span", { className: "soft" }, "never flew together"),
        ),
        grid,
      );
      Covey.flightCharts.pair(this._chartView(), grid, first, second);
      this._content.append(element("h2", { className: "subhead" }, "Events and orders of the two"));
      this._showEvents([flight.names[first], flight.names[second]]);
    }

    _pairWords([, , distance_m, time_s]) {
      const promise_m = this.flight.promise_m;
      const isBelow = promise_m !== null && distance_m < promise_m;
      return element(
        "span",
        { className: isBelow ? "bad" : null },
        `${isBelow ? "✗ " : ""}closest ${distance_m.toFixed(3)} m at `,
        element(
          "button",
          { type: "button", className: "time", on: { click: () => this.player.seek(time_s) } },
          clock(time_s),
        ),
      );
    }

    // -- pictures --------------------------------------------------------------------------------------

    _draw() {
      const { player, flight } = this;
      const positions = this.flightScene.draw(player.time_s);
      this.charts.setTime(player.time_s);
      this._onTime?.();

      this._clock.textContent = clock(player.time_s);
      this._time.textContent = `${clock(player.time_s)} / ${clock(player.end_s, 0)}`;
      this._slider.value = String(player.time_s);
      this._slider.setAttribute("aria-valuetext", clock(player.time_s));
      this._play.textContent = player.isPlaying ? "❚❚" : "▶";
      this._play.setAttribute("aria-label", player.isPlaying ? "Pause" : "Play");
      this._speed.value = String(player.speed);
      this._nearest.textContent = this._nearestWords(positions);
      this._subtitle.textContent = this._subtitleWords();
      this._drawLane();
      if (!player.isPlaying) this._writeAddress();
      document.documentElement.dataset.time = flight ? player.time_s.toFixed(3) : "";
    }

    _nearestWords(positions) {
      const nearest = this.flight.nearestPair(positions, this.player.time_s);
      if (!nearest) return "";
      const names = nearest.pair.map((vehicle) => Covey.shortened(this.flight.names[vehicle]));
      return `nearest ${names.join("–")} ${nearest.distance_m.toFixed(2)} m`;
    }

    /* Returns what has just happened, in words. */
    _subtitleWords() {
      const time_s = this.player.time_s;
      const recent = this._story.filter(
        (row) => row.time_s <= time_s + 1e-6 && row.time_s > time_s - SUBTITLE_S && !row.isOrder,
      );
      const row = recent[recent.length - 1];
      return row ? `${row.vehicle}: ${row.text}` : "";
    }

    /* Draws the events above the slider, and the distance below the promise in red. */
    _drawLane() {
      const lane = this._lane;
      const key = `${lane.clientWidth}/${Covey.isDark()}`;
      if (this._laneKey === key || !lane.clientWidth) return;
      this._laneKey = key;

      const ratio = globalThis.devicePixelRatio || 1;
      lane.width = lane.clientWidth * ratio;
      lane.height = lane.clientHeight * ratio;
      const context = lane.getContext("2d");
      context.scale(ratio, ratio);
      const { flight } = this;
      const length_s = Math.max(1e-6, flight.end_s - flight.begin_s);
      const inset_px = 8; // half of the slider's knob
      const width_px = lane.clientWidth - 2 * inset_px;
      const at = (time_s) => inset_px + (width_px * (time_s - flight.begin_s)) / length_s;

      for (const row of this._story) {
        const isGrave = row.severity === "critical" || row.severity === "warning";
        context.fillStyle = Covey.colour(rowColour(row));
        context.fillRect(at(row.time_s) - 0.75, isGrave ? 0 : 4, isGrave ? 2 : 1.5, isGrave ? 10 : 6);
      }
      if (flight.promise_m === null) return;
      context.fillStyle = Covey.colour("bad");
      flight.smallestDistances().forEach((distance_m, index) => {
        if (distance_m < flight.promise_m - 0.0005) {
          context.fillRect(at(flight.time_s[index]) - 1, 10, 2, 4);
        }
      });
    }

    // -- keys and addresses ----------------------------------------------------------------------------

    _listen() {
      Covey.moveByPointer(
        this._canvas,
        this.flightScene.scene.camera,
        () => this.player.draw(),
        () => {
          this.flightScene.followed = null;
          this._follow.value = "";
        },
      );
      document.addEventListener("keydown", (event) => this._onKey(event));
      addEventListener("hashchange", () => {
        this._readAddress();
        this._showView();
      });
      new ResizeObserver(() => this.player.draw()).observe(this._canvas);
      Covey.onThemeChange(() => {
        this._laneKey = null;
        this._showView();
      });
    }

    _onKey(event) {
      if (event.ctrlKey || event.metaKey || event.altKey || this._dialog.open) return;
      const tag = event.target.tagName;
      const isTyping = tag === "SELECT" || (tag === "INPUT" && event.target.type === "search");
      if (isTyping) return;

      const { player } = this;
      const camera = this.flightScene.scene.camera;
      const names = this.flight.names;
      const followed = this.flightScene.followed;
      const zoom = (factor) => {
        camera.zoom(factor);
        player.draw();
      };
      const actions = {
        " ": () => player.toggle(),
        ",": () => player.step(-STEP_S),
        ".": () => player.step(STEP_S),
        ArrowLeft: () => player.seek(player.time_s - JUMP_S),
        ArrowRight: () => player.seek(player.time_s + JUMP_S),
        n: () => this._toEvent(1),
        N: () => this._toEvent(-1),
        "<": () => player.changeSpeed(-1),
        ">": () => player.changeSpeed(1),
        Home: () => player.seek(player.begin_s),
        End: () => player.seek(player.end_s),
        f: () => this.follow(followed === null ? 0 : (followed + 1) % names.length),
        F: () => this.follow(null),
        p: () => this._toNearestPair(),
        t: () => this.lookFromAbove(),
        r: () => this.showAll(),
        "+": () => zoom(0.85),
        "-": () => zoom(1 / 0.85),
        "?": () => this._dialog.showModal(),
      };
      const page = /^[0-9]$/.test(event.key) ? VIEWS[(Number(event.key) + 9) % 10] : null;
      // a button that has the focus is pressed by the space bar, and nothing else
      const isButton = event.key === " " && (tag === "BUTTON" || tag === "SUMMARY");
      const action = page ? () => this.show(page[0]) : actions[event.key];
      if (!action || isButton) return;
      event.preventDefault();
      action();
    }

    _toEvent(direction) {
      const time_s = this.player.time_s;
      const others = this._story.filter((row) =>
        direction > 0 ? row.time_s > time_s + 0.01 : row.time_s < time_s - 0.01,
      );
      const row = direction > 0 ? others[0] : others[others.length - 1];
      if (row) this.player.seek(row.time_s);
    }

    _toNearestPair() {
      const positions = this.flight.names.map((_, vehicle) =>
        this.flight.positionAt(vehicle, this.player.time_s),
      );
      const nearest = this.flight.nearestPair(positions, this.player.time_s);
      if (nearest) this.showPair(...nearest.pair);
    }

    /* Returns the address of something, to be copied. */
    address({ pair = null, view = this.view, time_s = null } = {}) {
      const parts = [`t=${Number((time_s ?? this.player.time_s).toFixed(2))}`];
      if (view === "pair" && (pair ?? this.pair)) {
        const names = (pair ?? this.pair).map((vehicle) => this.flight.names[vehicle]);
        parts.push(`pair=${names.map(encodeURIComponent).join("-")}`);
      } else if (view !== "overview") {
        parts.push(`view=${view}`);
      }
      const followed = this.flightScene?.followed ?? null;
      if (followed !== null) parts.push(`follow=${encodeURIComponent(this.flight.names[followed])}`);
      return `#${parts.join("&")}`;
    }

    _writeAddress() {
      const address = this.address();
      if (location.hash === address) return;
      try {
        history.replaceState(null, "", address);
      } catch {
        // a browser that forbids it for files: the address stays as it was opened
      }
    }

    /* Shows what the address says; what it says wrongly is left as it is. */
    _readAddress() {
      const said = new Map(
        location.hash
          .slice(1)
          .split("&")
          .map((part) => part.split(/=(.*)/s).slice(0, 2).map(decoded)),
      );
      const time_s = Number.parseFloat(said.get("t"));
      if (Number.isFinite(time_s)) this.player.seek(time_s);

      const pair = said.has("pair") ? this.flight.pairNamed(said.get("pair")) : null;
      if (pair) {
        this.pair = pair;
        this.view = "pair";
      } else if (VIEWS.some(([name]) => name === said.get("view"))) {
        this.view = said.get("view");
      }

      const followed = this.flight.names.indexOf(said.get("follow"));
      if (followed >= 0) this.follow(followed);
    }
  }

  function decoded(text) {
    try {
      return decodeURIComponent(text ?? "");
    } catch {
      return "";
    }
  }

  function firstPair(flight) {
    return flight.names.length > 1 ? [0, 1] : null;
  }

  function rowColour(row) {
    if (row.severity === "critical") return "bad";
    if (row.severity === "warning") return "warn";
    return row.isOrder ? "accent" : "soft";
  }

  async function open() {
    const parent = document.getElementById("report");
    try {
      const bytes = Covey.bytesOf(document.getElementById("flight").textContent);
      const flight = Covey.flightOf(await Covey.inflated(bytes));
      globalThis.report = new Report(flight, parent);
    } catch (error) {
      const sentence = `This report cannot be shown: ${error.message}`;
      Covey.replace(parent, element("p", { className: "wait" }, sentence));
      throw error;
    }
  }

  open();
})();
