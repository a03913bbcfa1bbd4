/*
 * Draws a flight at one time: where everybody is, where they come from, what the law makes of it.
 */
"use strict";

globalThis.Covey ??= {};

(() => {
  const TRAIL_S = 8;
  const PAIR_SHARE = 1.75; // pairs nearer than so many promised distances have a line
  const MAX_PAIR_LINES = 24;
  const MIN_PUSH_M_S2 = 0.15; // interventions below it are not drawn
  const PUSH_M_PER_M_S2 = 0.25; // length of their arrows
  const DASH_S = 0.2; // of the way of another flight
  const DOT_S = 0.06; // of the way by PX4's own log
  const PLANE_M = 0.45; // half the length of a half-plane's edge
  const HATCH_M = 0.09; // length of its strokes to the side that is ruled out
  const MIN_WIDTH_PX = 520; // of a scene with room for more than distances
  const LAYERS = [
    ["trails", "Trails", true],
    ["names", "Names", true],
    ["rings", "Safety circles", true],
    ["pairs", "Distances of near pairs", true],
    ["law", "What the law changes", true],
    ["planes", "Half-planes of the law", false],
    ["setpoints", "Setpoints", false],
    ["way", "The whole way", false],
    ["ghost", "The other flight", true],
    ["px4", "Where PX4's own log has it", true],
  ];

  class FlightScene {
    constructor(flight, canvas, overlay, onChange = () => {}) {
      this.flight = flight;
      this.scene = new Covey.Scene(canvas, overlay);
      this.layers = Object.fromEntries(LAYERS.map(([name, , isOn]) => [name, isOn]));
      this.followed = null; // number of a vehicle
      this.pair = null; // numbers of two vehicles whose line is always drawn
      this._paths = new Map(); // key -> points
      this._bounds = this._boundsOfFlight();
      this._promise_m = flight.promise_m;
      this._ground = new Covey.Ground(flight.fleet?.ground, onChange);
    }

    /* Shows the whole flight. */
    fit() {
      const { least, most } = this._bounds;
      this.scene.camera.fit(least, most, this.scene.aspect);
    }

    _boundsOfFlight() {
      const flight = this.flight;
      const least = [Infinity, Infinity, 0];
      const most = [-Infinity, -Infinity, 1];
      flight.names.forEach((_, vehicle) => {
        ["x", "y", "z"].forEach((name, axis) => {
          for (const value of flight.curve(vehicle, name)) {
            if (value < least[axis]) least[axis] = value;
            if (value > most[axis]) most[axis] = value;
          }
        });
      });
      for (const axis of [0, 1]) {
        if (!Number.isFinite(least[axis])) [least[axis], most[axis]] = [-2, 2];
        least[axis] -= 0.5;
        most[axis] += 0.5;
      }
      return { least, most };
    }

    /* Returns the points (x, y, z, ...) of a vehicle's path. */
    _path(vehicle, prefix = "") {
      const key = `${vehicle}/${prefix}`;
      if (!this._paths.has(key)) {
        const axes = ["x", "y", "z"].map((axis) => this.flight.curve(vehicle, prefix + axis));
        const points = new Float32Array(3 * this.flight.count);
        for (let index = 0; index < this.flight.count; index++) {
          for (let axis = 0; axis < 3; axis++) points[3 * index + axis] = axes[axis][index];
        }
        this._paths.set(key, points);
      }
      return this._paths.get(key);
    }

    draw(time_s) {
      const { scene, flight } = this;
      const positions = flight.names.map((_, vehicle) => flight.positionAt(vehicle, time_s));
      if (this.followed !== null && positions[this.followed]) {
        scene.camera.target = [...positions[this.followed]];
      }

      scene.begin();
      this._drawWorld();
      flight.names.forEach((_, vehicle) => {
        this._drawGhost("ghost", vehicle, time_s, DASH_S);
        this._drawGhost("px4", vehicle, time_s, DOT_S);
      });
      this._drawPeople(time_s);
      flight.names.forEach((_, vehicle) => this._drawVehicle(vehicle, positions[vehicle], time_s));
      if (this.layers.pairs) this._drawPairs(positions, time_s);
      scene.end();
      return positions;
    }

    _drawWorld() {
      const { scene, flight } = this;
      const soft = Covey.rgb(Covey.colour("ground"));
      const { least, most } = this._bounds;
      this._ground.draw(scene);
      scene.ground(least, most, soft);

      if (!flight.fleet) return;
      const [low, high] = flight.fleet.fence;
      scene.box(low, high, soft, { opacity: 0.35 });
      const warning = Covey.rgb(Covey.colour("warn"));
      for (const area of flight.fleet.areas) scene.area(area, area.keeps_in ? soft : warning);
      for (const obstacle of flight.fleet.obstacles) this._drawObstacle(obstacle, soft);
    }

    /* Draws an obstacle's outline on the ground and at the height of the fence. */
    _drawObstacle(obstacle, colour) {
      const heights_m = [0, this.flight.fleet.fence[1][2]];
      for (const [x1, y1, x2, y2, radius_m] of obstacle.capsules_enu_m) {
        for (const height_m of heights_m) {
          if (radius_m > 0) this.scene.ring([x1, y1, height_m], radius_m, colour, { width: 1.5 });
          else this.scene.line([x1, y1, height_m], [x2, y2, height_m], colour, { width: 1.5 });
        }
        this.scene.line([x1, y1, 0], [x1, y1, heights_m[1]], colour, { opacity: 0.5 });
      }
      const [x, y] = obstacle.capsules_enu_m[0] ?? [0, 0];
      this.scene.label([x, y, 0], obstacle.name, { isQuiet: true });
    }

    /* Draws the circle of each person whom the motion capture sees, on the ground and at the head. */
    _drawPeople(time_s) {
      const colour = Covey.rgb(Covey.colour("warn"));
      (this.flight.fleet?.people ?? []).forEach(({ name, radius_m }, index) => {
        const head = this.flight.positionAt(`person${index}`, time_s);
        if (!head) return;
        const [x, y, z] = head;
        for (const height_m of [0, z]) {
          this.scene.ring([x, y, height_m], radius_m, colour, { width: 2 });
        }
        this.scene.line([x, y, 0], head, colour, { width: 2 });
        this.scene.label(head, name, { isQuiet: true });
      });
    }

    _drawVehicle(vehicle, position, time_s) {
      if (!position) return;
      const { scene, flight } = this;
      const text = Covey.vehicleColour(vehicle);
      const colour = Covey.rgb(text);
      const isUp = flight.isUp(vehicle, flight.indexAt(time_s));

      if (this.layers.way) {
        scene.path(this._path(vehicle), colour, { opacity: 0.35, width: 1.25 });
      }
      if (this.layers.trails) this._drawTrail(vehicle, position, time_s, colour);

      scene.body(position, flight.attitudeAt(vehicle, time_s), colour, {
        diameter_m: flight.fleet?.body_diameter_m ?? 0.5,
      });
      if (isUp) {
        scene.line(position, [position[0], position[1], 0], colour, { opacity: 0.3, width: 1 });
        scene.ring([position[0], position[1], 0], 0.08, colour, { opacity: 0.45 });
      }
      if (this.layers.rings && isUp && this._promise_m) {
        scene.ring(position, this._promise_m / 2, colour, { opacity: 0.65 });
      }
      if (this.layers.setpoints) this._drawSetpoint(vehicle, position, time_s, colour);
      if (this.layers.law) this._drawPush(vehicle, position, time_s, colour);
      if (this.layers.planes) this._drawPlane(vehicle, position, time_s, colour);
      if (this.layers.names) {
        const isFollowed = vehicle === this.followed;
        const name = shortened(flight.names[vehicle]);
        scene.label(position, isFollowed ? `◎ ${name}` : name, { colour: text, isStrong: true });
      }
    }

    _drawTrail(vehicle, position, time_s, colour) {
      const index = this.flight.indexAt(time_s);
      const from = Math.max(0, index - Math.round(TRAIL_S / this.flight.step_s));
      const points = this._path(vehicle);
      this.scene.path(points, colour, { from, to: index, width: 2.5, isFading: true });
      const last = [points[3 * index], points[3 * index + 1], points[3 * index + 2]];
      if (!last.some(Number.isNaN)) this.scene.line(last, position, colour, { width: 2.5 });
    }

    /* Draws a vehicle a second time, pale: where the other flight, or PX4's own log, has it. */
    _drawGhost(layer, vehicle, time_s, dash_s) {
      const prefix = `${layer}_`;
      if (!this.layers[layer] || !this.flight.has(vehicle, `${prefix}x`)) return;
      const position = this.flight.positionAt(vehicle, time_s, prefix);
      if (!position) return;

      const colour = Covey.rgb(Covey.vehicleColour(vehicle));
      const index = this.flight.indexAt(time_s);
      const from = Math.max(0, index - Math.round(TRAIL_S / this.flight.step_s));
      const dash = Math.max(1, Math.round(dash_s / this.flight.step_s));
      const points = this._path(vehicle, prefix);
      this.scene.path(points, colour, { from, to: index, opacity: 0.5, width: 1.5, dash });
      this.scene.body(position, null, colour, {
        opacity: 0.35,
        diameter_m: this.flight.fleet?.body_diameter_m ?? 0.5,
      });
    }

    _drawSetpoint(vehicle, position, time_s, colour) {
      const setpoint = this.flight.positionAt(vehicle, time_s, "setpoint_");
      if (!setpoint) return;
      const [x, y, z] = setpoint;
      this.scene.line(position, setpoint, colour, { opacity: 0.5, width: 1 });
      this.scene.line([x - 0.09, y, z], [x + 0.09, y, z], colour, { width: 1.5 });
      this.scene.line([x, y - 0.09, z], [x, y + 0.09, z], colour, { width: 1.5 });
    }

    /* Draws by how much the law changes a vehicle's thrust, as an arrow. */
    _drawPush(vehicle, position, time_s, colour) {
      const index = this.flight.indexAt(time_s);
      const push_m_s2 = ["x", "y", "z"].map(
        (axis) =>
          this.flight.curve(vehicle, `after_${axis}`)[index] -
          this.flight.curve(vehicle, `before_${axis}`)[index],
      );
      const strength_m_s2 = Math.hypot(...push_m_s2);
      if (!(strength_m_s2 > MIN_PUSH_M_S2)) return;

      const tip = position.map((value, axis) => value + PUSH_M_PER_M_S2 * push_m_s2[axis]);
      this.scene.line(position, tip, colour, { width: 4 });
      // the head: two strokes back from the tip
      const angle = Math.atan2(push_m_s2[1], push_m_s2[0]);
      const head_m = Math.min(0.12, 0.35 * PUSH_M_PER_M_S2 * strength_m_s2);
      for (const turn of [2.6, -2.6]) {
        const x = tip[0] + head_m * Math.cos(angle + turn);
        const y = tip[1] + head_m * Math.sin(angle + turn);
        this.scene.line(tip, [x, y, tip[2]], colour, { width: 4 });
      }
    }

    /*
     * Draws the half-plane that keeps the distance to whom the law intervenes for, at the vehicle as
     * the origin of accelerations: its edge, hatched to the side that is ruled out, and the thrust
     * before the law (a cross) and after it (a line from the vehicle).
     */
    _drawPlane(vehicle, position, time_s, colour) {
      const flight = this.flight;
      const index = flight.indexAt(time_s);
      if (!flight.has(vehicle, "row_bound")) return;
      const bound_m_s2 = flight.curve(vehicle, "row_bound")[index];
      const direction_rad = flight.curve(vehicle, "row_direction")[index];
      if (!Number.isFinite(bound_m_s2) || !Number.isFinite(direction_rad)) return;

      const [x, y, z] = position;
      const normal = [Math.cos(direction_rad), Math.sin(direction_rad)];
      const away_m = PUSH_M_PER_M_S2 * bound_m_s2;
      // a point of the edge: so far along it from its middle, and so far into what is ruled out
      const at = (along_m, into_m) => [
        x + (away_m - into_m) * normal[0] - along_m * normal[1],
        y + (away_m - into_m) * normal[1] + along_m * normal[0],
        z,
      ];
      this.scene.line(at(-PLANE_M, 0), at(PLANE_M, 0), colour, { width: 2 });
      for (let along_m = -PLANE_M; along_m < PLANE_M; along_m += HATCH_M) {
        this.scene.line(at(along_m, 0), at(along_m + HATCH_M, HATCH_M), colour, {
          opacity: 0.6,
          width: 1,
        });
      }

      const thrust = (name) => [
        x + PUSH_M_PER_M_S2 * flight.curve(vehicle, `${name}_x`)[index],
        y + PUSH_M_PER_M_S2 * flight.curve(vehicle, `${name}_y`)[index],
        z,
      ];
      this.scene.line(position, thrust("after"), colour, { width: 2.5 });
      const [before_x, before_y] = thrust("before");
      const cross_m = 0.05;
      for (const side of [-1, 1]) {
        this.scene.line(
          [before_x - cross_m, before_y - side * cross_m, z],
          [before_x + cross_m, before_y + side * cross_m, z],
          colour,
          { width: 2 },
        );
      }
    }

    /* Draws lines between vehicles that are near, with distance and age of what each knew. */
    _drawPairs(positions, time_s) {
      const flight = this.flight;
      const promise_m = this._promise_m ?? 0.8;
      const index = flight.indexAt(time_s);
      const near = [];
      for (let first = 0; first < positions.length; first++) {
        for (let second = first + 1; second < positions.length; second++) {
          const [one, other] = [positions[first], positions[second]];
          if (!one || !other) continue;
          if (!flight.isUp(first, index) && !flight.isUp(second, index)) continue;
          const distance_m = flight.separation(one, other);
          const isChosen = this.pair?.includes(first) && this.pair?.includes(second);
          if (isChosen || distance_m < PAIR_SHARE * promise_m) {
            near.push({ first, second, distance_m, isChosen });
          }
        }
      }

      near.sort((a, b) => b.isChosen - a.isChosen || a.distance_m - b.distance_m);
      for (const pair of near.slice(0, MAX_PAIR_LINES)) {
        this._drawPair(pair, positions, time_s, promise_m);
      }
    }

    _drawPair({ first, second, distance_m, isChosen }, positions, time_s, promise_m) {
      const isBelow = this._promise_m !== null && distance_m < promise_m - 0.0005;
      const name = isBelow ? "bad" : isChosen ? "accent" : "soft";
      const text = Covey.colour(name);
      const [one, other] = [positions[first], positions[second]];
      const closeness = Math.min(1, Math.max(0.25, 2 - distance_m / promise_m));
      this.scene.line(one, other, Covey.rgb(text), {
        opacity: isBelow || isChosen ? 1 : closeness,
        width: isBelow ? 3.5 : isChosen ? 2.5 : 1.5,
      });

      const hasRoom = isChosen || this.scene.width_px > MIN_WIDTH_PX;
      const ages = hasRoom ? this._ages(first, second, time_s) : "";
      const middle = one.map((value, axis) => (value + other[axis]) / 2);
      const sign = isBelow ? "! " : "";
      this.scene.label(middle, `${sign}${distance_m.toFixed(2)} m${ages}`, {
        colour: isBelow || isChosen ? text : null,
        shift: [0, 0],
        isStrong: isBelow,
      });
    }

    /* Returns the age of what each of two vehicles knew of the other, as text. */
    _ages(first, second, time_s) {
      const index = this.flight.indexAt(time_s);
      const ages_ms = [
        this.flight.curve(first, `age/${second}`)[index] * 1000,
        this.flight.curve(second, `age/${first}`)[index] * 1000,
      ];
      if (ages_ms.every(Number.isNaN)) return "";
      return ` · ${ages_ms.map((age) => Covey.number(age, 0)).join("/")} ms`;
    }
  }

  /* Returns a name that fits into a picture. */
  function shortened(name) {
    return name.length > 18 ? `${name.slice(0, 17)}…` : name;
  }

  Object.assign(Covey, { FlightScene, LAYERS, shortened });
})();
