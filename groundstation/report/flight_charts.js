/*
 * The curves of a flight, by subject. Each function adds its charts to an element.
 *
 * `view` has the flight, the group of charts, the numbers of the chosen vehicles, and the marks of
 * events that all charts show.
 */
"use strict";

globalThis.Covey ??= {};

(() => {
  const MAX_PAIRS = 6;
  const CLOSING_S = 0.3;

  /* Adds a chart unless the record has none of its values. */
  function chart(view, parent, options) {
    const known = options.series.filter((one) => one.values.some((value) => !Number.isNaN(value)));
    if (!known.length) {
      missing(parent, options.title);
      return;
    }
    view.charts.add(parent, { time_s: view.flight.time_s, marks: view.marks, ...options, series: known });
  }

  function missing(parent, title) {
    parent.append(
      Covey.element(
        "p",
        { className: "missing" },
        `${title}: the record has no values.`,
      ),
    );
  }

  /* Returns a curve for each chosen vehicle. */
  function perVehicle(view, name, { factor = 1, ...more } = {}) {
    return view.chosen.map((vehicle) => ({
      label: Covey.shortened(view.flight.names[vehicle]),
      values: scaled(view.flight.curve(vehicle, name), factor),
      colour: Covey.vehicleColour(vehicle),
      ...more,
    }));
  }

  /* Returns a function for the upright axis that begins at 0. */
  function fromZero(least_most) {
    return (low, high) => [Math.min(0, low), Math.max(least_most, high) * 1.08];
  }

  function scaled(values, factor) {
    return factor === 1 ? values : values.map((value) => value * factor);
  }

  function promise(flight) {
    if (flight.promise_m === null) return [];
    return [{ value: flight.promise_m, text: `promised ${flight.promise_m.toFixed(2)} m` }];
  }

  /* Distances are read near the promise: far ones do not flatten the curve, unless all are far. */
  function nearRange(flight, series) {
    const nearest_m = Math.min(...series.map((one) => smallest(one.values)));
    const most_m = Math.max(4 * (flight.promise_m ?? 1), 1.5 * nearest_m);
    return (_, high) => [0, Math.min(high * 1.05, most_m)];
  }

  /* Returns the smallest of the known values, Infinity where none is known. */
  function smallest(values) {
    return values.reduce((least, value) => (value < least ? value : least), Infinity);
  }

  function distances(view, parent) {
    const { flight } = view;
    if (flight.names.length < 2) {
      parent.append(Covey.element("p", { className: "missing" }, "One vehicle has no distances."));
      return;
    }

    const smallestOfAll = [
      {
        label: "smallest",
        values: flight.smallestDistances(),
        colour: Covey.colour("text"),
        width: 2,
      },
    ];
    chart(view, parent, {
      title: "Smallest distance of all pairs",
      unit: "m",
      height: 170,
      series: smallestOfAll,
      limits: promise(flight),
      range: nearRange(flight, smallestOfAll),
    });

    const nearest = flight.pairs.slice(0, MAX_PAIRS);
    const ofPairs = nearest.map(([first, second], index) => ({
      label: `${Covey.shortened(flight.names[first])}–${Covey.shortened(flight.names[second])}`,
      values: flight.distances(first, second),
      colour: Covey.vehicleColour(index),
    }));
    chart(view, parent, {
      title: nearest.length < flight.pairs.length ? "The nearest pairs" : "Each pair",
      unit: "m",
      height: 210,
      series: ofPairs,
      limits: promise(flight),
      range: nearRange(flight, ofPairs),
    });
  }

  function law(view, parent) {
    const { flight } = view;
    chart(view, parent, {
      title: "By how much the law changes the thrust",
      range: fromZero(1),
      unit: "m/s²",
      series: perVehicle(view, "intervention"),
    });
    chart(view, parent, {
      title: "By how much its constraints had to be relaxed",
      range: fromZero(0.5),
      unit: "m/s²",
      height: 110,
      series: perVehicle(view, "slack"),
    });

    for (const [axis, name] of [["x", "east"], ["y", "north"], ["z", "up"]]) {
      chart(view, parent, {
        title: `Thrust per mass, ${name}: before the law (dotted) and after it`,
        unit: "m/s²",
        series: view.chosen.flatMap((vehicle) => [
          {
            label: "before",
            values: flight.curve(vehicle, `before_${axis}`),
            colour: Covey.vehicleColour(vehicle),
            dash: [2, 4],
          },
          {
            label: `${Covey.shortened(flight.names[vehicle])} after`,
            values: flight.curve(vehicle, `after_${axis}`),
            colour: Covey.vehicleColour(vehicle),
            width: 1.75,
          },
        ]),
      });
    }
  }

  function motion(view, parent) {
    const { flight } = view;
    for (const [axis, name] of [["x", "east"], ["y", "north"], ["z", "up"]]) {
      chart(view, parent, {
        title: `Position, ${name}, and its setpoint (dotted)`,
        unit: "m",
        series: view.chosen.flatMap((vehicle) => [
          {
            label: "setpoint",
            values: flight.curve(vehicle, `setpoint_${axis}`),
            colour: Covey.vehicleColour(vehicle),
            dash: [2, 4],
          },
          {
            label: Covey.shortened(flight.names[vehicle]),
            values: flight.curve(vehicle, axis),
            colour: Covey.vehicleColour(vehicle),
            width: 1.75,
          },
        ]),
      });
    }
    if (flight.has_truth) {
      chart(view, parent, {
        title: "Error of its own estimate, in plan",
        unit: "cm",
        height: 120,
        decimals: 1,
        series: perVehicle(view, "x").map((series, index) => {
          const vehicle = view.chosen[index];
          return { ...series, values: estimateError_cm(flight, vehicle) };
        }),
      });
    }
    chart(view, parent, {
      title: "Throttle",
      unit: "0 to 1",
      height: 120,
      series: perVehicle(view, "throttle"),
    });
  }

  function estimateError_cm(flight, vehicle) {
    const [x, y] = [flight.curve(vehicle, "x"), flight.curve(vehicle, "y")];
    const [ownX, ownY] = ["x", "y"].map((axis) => flight.curve(vehicle, `estimate_${axis}`));
    return x.map((value, index) => 100 * Math.hypot(value - ownX[index], y[index] - ownY[index]));
  }

  function air(view, parent) {
    const { flight } = view;
    const speeds = (vehicle) => {
      const east = flight.curve(vehicle, "wind_x");
      const north = flight.curve(vehicle, "wind_y");
      return east.map((value, index) => Math.hypot(value, north[index]));
    };
    const limit_m_s = view.chosen
      .map((vehicle) => flight.curve(vehicle, "max_wind").find((value) => !Number.isNaN(value)))
      .filter((value) => value !== undefined);
    chart(view, parent, {
      title: "Wind that each vehicle feels",
      range: fromZero(1),
      unit: "m/s",
      series: perVehicle(view, "wind_x").map((series, index) => ({
        ...series,
        values: speeds(view.chosen[index]),
      })),
      limits: limit_m_s.length
        ? [{ value: Math.min(...limit_m_s), text: `limit ${Math.min(...limit_m_s).toFixed(1)} m/s` }]
        : [],
    });
    chart(view, parent, {
      title: "Gusts, standard deviation",
      range: fromZero(1),
      unit: "m/s",
      height: 110,
      series: perVehicle(view, "gust"),
    });
    if (view.chosen.some((vehicle) => flight.has(vehicle, "fix"))) {
      chart(view, parent, {
        title: "Fix by satellites (3: 3D, 5: RTK float, 6: RTK fixed)",
        unit: "",
        height: 110,
        decimals: 0,
        series: perVehicle(view, "fix"),
        range: () => [0, 7],
      });
      chart(view, parent, {
        title: "Age of the RTK corrections",
        range: fromZero(2),
        unit: "s",
        height: 110,
        series: perVehicle(view, "corrections_age"),
      });
    }
    chart(view, parent, {
      title: "Battery",
      unit: "%",
      decimals: 0,
      series: perVehicle(view, "battery", { factor: 100 }),
      limits: flight.fleet
        ? [{ value: 100 * flight.fleet.battery_land_frac, text: "lands by itself" }]
        : [],
      range: (low, high) => [0, Math.max(100, high)],
    });
    chart(view, parent, {
      title: "Battery voltage",
      unit: "V",
      height: 120,
      series: perVehicle(view, "voltage"),
    });
  }

  function loop(view, parent) {
    chart(view, parent, {
      title: "Period of the control loop (nominal 20 ms), the longest of each step",
      range: fromZero(30),
      unit: "ms",
      decimals: 1,
      series: perVehicle(view, "period", { factor: 1000 }),
    });
    chart(view, parent, {
      title: "Age of the neighbour that was silent for longest",
      range: fromZero(50),
      unit: "ms",
      decimals: 0,
      series: perVehicle(view, "neighbour_age", { factor: 1000 }),
    });
    chart(view, parent, {
      title: "Age of its own position",
      range: fromZero(50),
      unit: "ms",
      height: 120,
      decimals: 0,
      series: perVehicle(view, "state_age", { factor: 1000 }),
    });
    chart(view, parent, {
      title: "Age of PX4's attitude",
      range: fromZero(20),
      unit: "ms",
      height: 120,
      decimals: 0,
      series: perVehicle(view, "attitude_age", { factor: 1000 }),
    });
    chart(view, parent, {
      title: "Time from a pose's measurement to its arrival",
      range: fromZero(5),
      unit: "ms",
      height: 110,
      decimals: 1,
      series: perVehicle(view, "mocap_delay", { factor: 1000 }),
    });
    for (const [name, title] of [
      ["late_ticks", "Late ticks since the agent's start"],
      ["missed_ticks", "Missed ticks since the agent's start"],
      ["lost_messages", "Messages that were lost, late or refused"],
    ]) {
      chart(view, parent, {
        title,
        height: 110,
        decimals: 0,
        range: fromZero(5),
        series: perVehicle(view, name),
      });
    }
  }

  /* Returns curves of PX4's own log: what it wanted (dotted), what it believed, what Covey had. */
  function beside(view, wanted, believed, own, { factor = 1 } = {}) {
    return view.chosen.flatMap((vehicle) => {
      const name = Covey.shortened(view.flight.names[vehicle]);
      const colour = Covey.vehicleColour(vehicle);
      const curve = (column) => scaled(view.flight.curve(vehicle, column), factor);
      const series = [
        { label: `${name} PX4`, values: curve(believed), colour, width: 1.75 },
        { label: "Covey", values: curve(own), colour: Covey.colour("text"), dash: [6, 3] },
      ];
      if (wanted) series.unshift({ label: "PX4's setpoint", values: curve(wanted), colour, dash: [2, 4] });
      return series;
    });
  }

  /* PX4's own log beside the record. */
  function px4(view, parent) {
    if (!view.flight.px4.length) return;
    for (const [angle, title] of [
      ["roll", "Roll, to the right"],
      ["pitch", "Pitch, nose up"],
      ["heading", "Heading, clockwise from north"],
    ]) {
      chart(view, parent, {
        title: `${title}: PX4's log, its setpoint (dotted), and what Covey had (dashed)`,
        unit: "°",
        decimals: 1,
        height: 140,
        series: beside(view, `px4_setpoint_${angle}`, `px4_${angle}`, `own_${angle}`),
      });
    }
    for (const [axis, name] of [["x", "east"], ["y", "north"], ["z", "up"]]) {
      chart(view, parent, {
        title: `Position, ${name}: PX4's estimate, shifted by the median, and the record (dashed)`,
        unit: "m",
        height: 140,
        series: beside(view, `px4_setpoint_${axis}`, `px4_${axis}`, axis),
      });
    }
    chart(view, parent, {
      title: "Battery voltage: PX4's log, and its telemetry (dashed)",
      unit: "V",
      height: 120,
      series: beside(view, null, "px4_voltage", "voltage"),
    });
    chart(view, parent, {
      title: "Charge: PX4's log, and its telemetry (dashed)",
      unit: "%",
      decimals: 0,
      height: 120,
      series: beside(view, null, "px4_battery", "battery", { factor: 100 }),
    });
  }

  /* The charts of a pair's page. */
  function pair(view, parent, first, second) {
    const { flight } = view;
    const names = [first, second].map((vehicle) => Covey.shortened(flight.names[vehicle]));
    const distance_m = flight.distances(first, second);
    const ofThePair = [
      { label: names.join("–"), values: distance_m, colour: Covey.colour("text"), width: 2 },
    ];
    chart(view, parent, {
      title: "Distance",
      unit: "m",
      height: 180,
      series: ofThePair,
      limits: promise(flight),
      range: nearRange(flight, ofThePair),
    });
    chart(view, parent, {
      title: "Speed at which they come nearer",
      unit: "m/s",
      height: 120,
      series: [
        {
          label: "closing",
          values: closing_m_s(flight, distance_m),
          colour: Covey.colour("text"),
        },
      ],
    });
    chart(view, parent, {
      title: "Age of what each knew of the other",
      unit: "ms",
      range: fromZero(50),
      decimals: 0,
      series: [[first, second, names], [second, first, [...names].reverse()]].map(
        ([knowing, known, [one, other]]) => ({
          label: `${one} of ${other}`,
          values: scaled(flight.curve(knowing, `age/${known}`), 1000),
          colour: Covey.vehicleColour(knowing),
        }),
      ),
    });
    chart(view, parent, {
      title: "Who avoids whom: change of the thrust for the other's sake",
      range: fromZero(1),
      unit: "m/s²",
      series: [[first, second, names], [second, first, [...names].reverse()]].map(
        ([avoiding, avoided, [one, other]]) => ({
          label: `${one} for ${other}`,
          values: intervention(flight, avoiding, avoided),
          colour: Covey.vehicleColour(avoiding),
          width: 2,
        }),
      ),
    });
    chart(view, parent, {
      title: "Height",
      unit: "m",
      height: 120,
      series: [first, second].map((vehicle) => ({
        label: Covey.shortened(flight.names[vehicle]),
        values: flight.curve(vehicle, "z"),
        colour: Covey.vehicleColour(vehicle),
      })),
    });
  }

  /* Returns the closing speed, by distances that are CLOSING_S apart: nearer ones are noise. */
  function closing_m_s(flight, distance_m) {
    const half = Math.max(1, Math.round(CLOSING_S / 2 / flight.step_s));
    return distance_m.map((_, index) => {
      const [before_m, after_m] = [distance_m[index - half], distance_m[index + half]];
      if (before_m === undefined || after_m === undefined) return NaN;
      return (before_m - after_m) / (2 * half * flight.step_s);
    });
  }

  /* Returns a vehicle's intervention while it avoids the other one, 0 while it does not. */
  function intervention(flight, avoiding, avoided) {
    const whom = flight.curve(avoiding, "avoided");
    const values = flight.curve(avoiding, "intervention");
    return values.map((value, index) => (Math.round(whom[index]) === avoided ? value : value * 0));
  }

  Covey.flightCharts = { distances, law, motion, air, loop, px4, pair };
  Covey.smallest = smallest;
})();
