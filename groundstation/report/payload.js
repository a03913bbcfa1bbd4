/*
 * Reads the data of a report: the reverse of payload.py and columns.py.
 *
 * A flight has its header and its curves. Each curve is unpacked when it is asked for the first time,
 * and has a value for each time of the one grid; what is not known is NaN.
 */
"use strict";

globalThis.Covey ??= {};

(() => {
  const FORMAT = 1;
  const NOT_KNOWN = -32768;

  /* Returns the bytes of base64. */
  function bytesOf(base64) {
    const text = atob(base64);
    const bytes = new Uint8Array(text.length);
    for (let index = 0; index < text.length; index++) bytes[index] = text.charCodeAt(index);
    return bytes;
  }

  /* Returns what was deflated. */
  async function inflated(bytes) {
    const stream = new Blob([bytes]).stream().pipeThrough(new DecompressionStream("deflate"));
    return new Uint8Array(await new Response(stream).arrayBuffer());
  }

  /* Returns the flight of inflated data; an Error with a sentence where it cannot be read. */
  function flightOf(bytes) {
    const view = new DataView(bytes.buffer, bytes.byteOffset, bytes.byteLength);
    const headLength = view.getUint32(0, true);
    const head = new TextDecoder().decode(bytes.subarray(4, 4 + headLength));
    const header = JSON.parse(head);
    if (header.format !== FORMAT) {
      throw new Error(`This page reads form ${FORMAT} of the data; the file has ${header.format}.`);
    }
    return new Flight(header, bytes.subarray(4 + headLength));
  }

  class Flight {
    constructor(header, data) {
      Object.assign(this, header);
      this._data = data;
      this._curves = new Map(); // key -> values
      this._up = []; // whether each vehicle is off the ground, at each time of the grid

      this._columns = new Map();
      header.columns.forEach(([key, scale, offset], index) => {
        this._columns.set(key, { scale, offset, begin: index * 2 * header.count });
      });

      this.time_s = Float64Array.from(
        { length: header.count },
        (_, index) => header.begin_s + index * header.step_s,
      );
      this.end_s = this.time_s[header.count - 1];
      this.names = header.vehicles.map((vehicle) => vehicle.name);
    }

    /* Whether the record has this curve of a vehicle. */
    has(vehicle, name) {
      return this._columns.has(`${vehicle}/${name}`);
    }

    /* Returns a curve of a vehicle: a value for each time; all NaN where the record has none. */
    curve(vehicle, name) {
      const key = `${vehicle}/${name}`;
      if (!this._curves.has(key)) this._curves.set(key, this._unpacked(this._columns.get(key)));
      return this._curves.get(key);
    }

    _unpacked(column) {
      const values = new Float32Array(this.count).fill(NaN);
      if (!column) return values;

      const low = this._data.subarray(column.begin, column.begin + this.count);
      const high = this._data.subarray(column.begin + this.count, column.begin + 2 * this.count);
      let number = 0;
      for (let index = 0; index < this.count; index++) {
        number = (number + low[index] + 256 * high[index]) & 0xffff;
        const signed = number > 32767 ? number - 65536 : number;
        if (signed !== NOT_KNOWN) values[index] = column.offset + column.scale * signed;
      }
      return values;
    }

    /* Returns the index of the last time of the grid that is not after a time. */
    indexAt(time_s) {
      const index = Math.floor((time_s - this.begin_s) / this.step_s + 1e-6);
      return Math.min(this.count - 1, Math.max(0, index));
    }

    /* Returns a position (x, y, z) at any time, on the straight line between two samples. */
    positionAt(vehicle, time_s, prefix = "") {
      const index = this.indexAt(time_s);
      const next = Math.min(index + 1, this.count - 1);
      const share = Math.min(1, Math.max(0, (time_s - this.time_s[index]) / this.step_s));

      const position = ["x", "y", "z"].map((axis) => {
        const values = this.curve(vehicle, prefix + axis);
        const [from, to] = [values[index], values[next]];
        return Number.isNaN(to) ? from : from + (to - from) * share;
      });
      return position.some(Number.isNaN) ? null : position;
    }

    /* Returns an attitude (w, x, y, z) at a time; null where it is not known. */
    attitudeAt(vehicle, time_s) {
      if (!this.has(vehicle, "qw")) return null;
      const index = this.indexAt(time_s);
      const parts = ["qw", "qx", "qy", "qz"].map((name) => this.curve(vehicle, name)[index]);
      const length = Math.hypot(...parts);
      if (!(length > 0.5)) return null;
      return parts.map((part) => part / length);
    }

    /* Returns whether a vehicle is off the ground at a time of the grid. */
    isUp(vehicle, index) {
      this._up[vehicle] ??= this.curve(vehicle, "is_up");
      return this._up[vehicle][index] > 0.5;
    }

    /* Returns the last text of a list of changes [time, text] that is not after a time. */
    textAt(changes, time_s) {
      let text = "";
      for (const [begin_s, words] of changes) {
        if (begin_s > time_s) break;
        text = words;
      }
      return text;
    }

    /* The separation of two vehicles, as the law, the checks and the verdict judge it. */
    separation(first, second) {
      const height_share = this.fleet?.height_share ?? 0;
      const across_m = Math.hypot(first[0] - second[0], first[1] - second[1]);
      if (height_share <= 0) return across_m;
      return Math.max(across_m, height_share * Math.abs(first[2] - second[2]));
    }

    /* Returns the two vehicles with the smallest separation, of which one flies; null for none. */
    nearestPair(positions, time_s) {
      const index = this.indexAt(time_s);
      let nearest = null;
      for (let first = 0; first < positions.length; first++) {
        for (let second = first + 1; second < positions.length; second++) {
          if (!positions[first] || !positions[second]) continue;
          if (!this.isUp(first, index) && !this.isUp(second, index)) continue;
          const distance_m = this.separation(positions[first], positions[second]);
          if (!nearest || distance_m < nearest.distance_m) {
            nearest = { pair: [first, second], distance_m };
          }
        }
      }
      return nearest;
    }

    /* Returns the separation of two vehicles at each time of the grid; NaN while neither flies. */
    distances(first, second) {
      const key = `${first}-${second}/distance`;
      if (this._curves.has(key)) return this._curves.get(key);

      const one = ["x", "y", "z"].map((axis) => this.curve(first, axis));
      const other = ["x", "y", "z"].map((axis) => this.curve(second, axis));
      const height_share = this.fleet?.height_share ?? 0;
      const values = new Float32Array(this.count);
      for (let index = 0; index < this.count; index++) {
        const across_m = Math.hypot(one[0][index] - other[0][index], one[1][index] - other[1][index]);
        const up_m = height_share * Math.abs(one[2][index] - other[2][index]);
        const isOneUp = this.isUp(first, index) || this.isUp(second, index);
        values[index] = isOneUp ? Math.max(across_m, up_m) : NaN;
      }
      this._curves.set(key, values);
      return values;
    }

    /* Returns the smallest separation of all pairs at each time of the grid. */
    smallestDistances() {
      const key = "smallest/distance";
      if (this._curves.has(key)) return this._curves.get(key);

      const smallest = new Float32Array(this.count).fill(NaN);
      for (let first = 0; first < this.names.length; first++) {
        for (let second = first + 1; second < this.names.length; second++) {
          const distances = this.distances(first, second);
          for (let index = 0; index < this.count; index++) {
            if (!(smallest[index] <= distances[index])) smallest[index] = distances[index];
          }
        }
      }
      this._curves.set(key, smallest);
      return smallest;
    }

    /* The distance that was promised: of the mission, else of the fleet file; null for none. */
    get promise_m() {
      const check = (this.verdict.checks ?? []).find((one) => one?.name === "min_separation_m");
      if (Number.isFinite(check?.limit_m)) return check.limit_m;

      // records of older versions have it only in the sentence
      const words = /^At least ([0-9.]+) m/.exec(check?.sentence ?? "");
      if (words) return Number(words[1]);
      return this.fleet?.safety_distance_m ?? null;
    }

    /* Returns the numbers of two vehicles named "a-b"; null where there are no such ones. */
    pairNamed(text) {
      for (let cut = text.indexOf("-"); cut >= 0; cut = text.indexOf("-", cut + 1)) {
        const first = this.names.indexOf(text.slice(0, cut));
        const second = this.names.indexOf(text.slice(cut + 1));
        if (first >= 0 && second >= 0 && first !== second) return [first, second];
      }
      return null;
    }
  }

  Object.assign(Covey, { bytesOf, inflated, flightOf });
})();
