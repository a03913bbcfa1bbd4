/*
 * Curves over the time of a flight, one below the other, with one time for all.
 *
 * uPlot draws the curves. This file gives them the page's colours, puts limits and events in line
 * with them, and keeps the charts of a group together: they show the same part of the flight, a line
 * in each says where in the flight the scene is, and a click in one leads there.
 */
"use strict";

globalThis.Covey ??= {};

(() => {
  // prettier-ignore
  const STEPS_S = [
    0.02, 0.05, 0.1, 0.2, 0.5, 1, 2, 5, 10, 15, 30, 60, 120, 300, 600, 900, 1800, 3600, 7200, 21600,
  ]; // between two times that are written
  const CLICK_PX = 4; // a pointer that moved further has dragged

  class ChartGroup {
    /* onSeek: called with a time in seconds when somebody clicks in a chart. */
    constructor({ onSeek = () => {} } = {}) {
      this._onSeek = onSeek;
      this._charts = [];
      this._time_s = 0;
      this._span_s = null; // the part of the flight that is shown; null: all of it
      this._isSpreading = false;
      this._key = `covey-${Math.random()}`;
      this._resizes = new ResizeObserver((entries) => this._fit(entries));
    }

    /*
     * Adds a chart to an element.
     *
     * title, unit: above it
     * time_s: array of times
     * series: {label, values, colour, width, dash}; NaN in values is a gap
     * limits: {value, text}, drawn as dashed lines
     * marks: {time_s, colour}, drawn as short strokes at the lower edge
     * range: function (least, most) -> [least, most] of the axis, where its default does not fit
     */
    add(parent, options) {
      const chart = new Chart(this, parent, options);
      this._charts.push(chart);
      this._resizes.observe(chart.frame);
      return chart;
    }

    /* Shows where in the flight the scene is. */
    setTime(time_s) {
      this._time_s = time_s;
      for (const chart of this._charts) chart.showTime(time_s);
    }

    /* Removes all charts. */
    clear() {
      for (const chart of this._charts) {
        this._resizes.unobserve(chart.frame);
        chart.remove();
      }
      this._charts = [];
    }

    seek(time_s) {
      this._onSeek(time_s);
    }

    /* One chart shows another part of the flight: all others follow. */
    spread(source, span_s) {
      if (this._isSpreading) return;
      this._isSpreading = true;
      this._span_s = span_s;
      for (const chart of this._charts) {
        if (chart !== source) chart.showSpan(span_s);
      }
      this._isSpreading = false;
      this.setTime(this._time_s);
    }

    get span_s() {
      return this._span_s;
    }

    get key() {
      return this._key;
    }

    get time_s() {
      return this._time_s;
    }

    _fit(entries) {
      for (const entry of entries) {
        const chart = this._charts.find((one) => one.frame === entry.target);
        chart?.fit(entry.contentRect.width);
      }
      this.setTime(this._time_s);
    }
  }

  class Chart {
    constructor(group, parent, options) {
      this._group = group;
      this._options = options;
      this._time_s = options.time_s;
      this._height_px = options.height ?? 150;

      this._values = options.series.map(() => Covey.element("span", { className: "value" }));
      const legend = options.series.map((series, index) => this._entry(series, index));
      this.frame = Covey.element("div", { className: "chart-frame" });
      this._box = Covey.element(
        "section",
        { className: "chart" },
        Covey.element(
          "header",
          {},
          Covey.element("h3", {}, options.title),
          options.unit ? Covey.element("span", { className: "unit" }, options.unit) : null,
          Covey.element("div", { className: "legend" }, legend),
        ),
        this.frame,
      );
      parent.append(this._box);

      this._line = Covey.element("div", { className: "chart-time" });
      this._plot = new uPlot(this._settings(), this._data(), this.frame);
      this._plot.over.append(this._line);
      this._listen();
      if (group.span_s) this.showSpan(group.span_s);
      this.showTime(group.time_s);
    }

    /* Returns one curve's entry of the legend; a click hides the curve. */
    _entry(series, index) {
      const swatch = Covey.element("i", { className: series.dash ? "swatch dashed" : "swatch" });
      swatch.style.color = series.colour;
      return Covey.element(
        "button",
        {
          type: "button",
          "aria-pressed": "true",
          on: {
            click: (event) => {
              const isShown = !this._plot.series[index + 1].show;
              this._plot.setSeries(index + 1, { show: isShown });
              event.currentTarget.setAttribute("aria-pressed", String(isShown));
            },
          },
        },
        swatch,
        series.label,
        this._values[index],
      );
    }

    _settings() {
      const grid = { stroke: Covey.colour("grid"), width: 1 };
      const axis = {
        stroke: Covey.colour("soft"),
        grid,
        ticks: { show: false },
        font: "11px system-ui, sans-serif",
      };
      const series = this._options.series.map((one) => ({
        label: one.label,
        stroke: one.colour,
        width: one.width ?? 1.5,
        dash: one.dash,
        points: { show: false },
        spanGaps: false,
      }));
      return {
        width: Math.max(120, this.frame.clientWidth || 300),
        height: this._height_px,
        padding: [6, 18, 0, 0],
        legend: { show: false },
        cursor: {
          sync: { key: this._group.key, setSeries: false },
          points: { size: 6 },
          drag: { x: true, y: false, dist: 2 * CLICK_PX },
          y: false,
        },
        scales: { x: { time: false }, y: { range: (_, low, high) => this._range(low, high) } },
        axes: [
          {
            ...axis,
            size: 22,
            gap: 3,
            space: 60,
            incrs: STEPS_S,
            values: (_, ticks) => ticks.map(secondsText),
          },
          { ...axis, size: 46, gap: 4, space: 30 },
        ],
        series: [{}, ...series],
        hooks: {
          draw: [(plot) => this._drawMarks(plot)],
          setScale: [(plot, name) => this._onScale(plot, name)],
        },
      };
    }

    _data() {
      const gaps = (values) => Array.from(values, (value) => (Number.isNaN(value) ? null : value));
      return [Array.from(this._time_s), ...this._options.series.map((one) => gaps(one.values))];
    }

    /* Returns the range of the upright axis: the curves, the limits, and some air. */
    _range(low, high) {
      const limits = (this._options.limits ?? []).map((limit) => limit.value);
      const known = [low, high, ...limits].filter((value) => Number.isFinite(value));
      if (!known.length) return [0, 1];

      const [least, most] = [Math.min(...known), Math.max(...known)];
      if (this._options.range) return this._options.range(least, most);
      const air = (most - least || Math.abs(most) || 1) * 0.06;
      return [least - air, most + air];
    }

    /* Draws the limits with their texts, and a stroke for each event. */
    _drawMarks(plot) {
      const context = plot.ctx;
      const { left, top, width, height } = plot.bbox;
      const ratio = globalThis.devicePixelRatio || 1;
      context.save();
      context.beginPath();
      context.rect(left, top, width, height);
      context.clip();

      for (const limit of this._options.limits ?? []) {
        const y = plot.valToPos(limit.value, "y", true);
        context.strokeStyle = Covey.colour("bad");
        context.lineWidth = 1.25 * ratio;
        context.setLineDash([5 * ratio, 4 * ratio]);
        context.beginPath();
        context.moveTo(left, y);
        context.lineTo(left + width, y);
        context.stroke();
        context.fillStyle = Covey.colour("bad");
        context.font = `${11 * ratio}px system-ui, sans-serif`;
        context.textAlign = "right";
        const isHigh = y < top + 16 * ratio;
        context.textBaseline = isHigh ? "top" : "bottom";
        context.fillText(limit.text, left + width - 4 * ratio, y + (isHigh ? 3 : -2) * ratio);
      }

      context.setLineDash([]);
      for (const mark of this._options.marks ?? []) {
        const x = plot.valToPos(mark.time_s, "x", true);
        context.fillStyle = mark.colour;
        context.fillRect(x - ratio / 2, top + height - 7 * ratio, 1.5 * ratio, 7 * ratio);
      }
      context.restore();
    }

    /* Tells the group when another part of the flight is shown: by a drag, or by a double click. */
    _onScale(plot, name) {
      if (name !== "x" || this._plot !== plot) return;
      const { min, max } = plot.scales.x;
      const isAll = min <= this._time_s[0] && max >= this._time_s[this._time_s.length - 1];
      this._group.spread(this, isAll ? null : [min, max]);
    }

    _listen() {
      let pressed_px = null;
      const over = this._plot.over;
      over.addEventListener("pointerdown", (event) => {
        pressed_px = event.clientX;
      });
      over.addEventListener("click", (event) => {
        const hasMoved = pressed_px === null || Math.abs(event.clientX - pressed_px) > CLICK_PX;
        if (hasMoved) return;
        const offset_px = event.clientX - over.getBoundingClientRect().left;
        this._group.seek(this._plot.posToVal(offset_px, "x"));
      });
    }

    showSpan(span_s) {
      const [min, max] = span_s ?? [this._time_s[0], this._time_s[this._time_s.length - 1]];
      this._plot.setScale("x", { min, max });
    }

    showTime(time_s) {
      const x_px = this._plot.valToPos(time_s, "x");
      const isInside = x_px >= 0 && x_px <= this._plot.over.clientWidth;
      this._line.style.transform = `translateX(${Math.round(x_px)}px)`;
      this._line.hidden = !isInside;

      const index = nearestBefore(this._time_s, time_s);
      this._options.series.forEach((series, number) => {
        const value = series.values[index];
        const decimals = series.decimals ?? this._options.decimals ?? 2;
        const text = series.text ? series.text(value) : Covey.number(value, decimals);
        if (this._values[number].textContent !== text) this._values[number].textContent = text;
      });
    }

    fit(width_px) {
      if (width_px > 0) this._plot.setSize({ width: width_px, height: this._height_px });
    }

    remove() {
      this._plot.destroy();
      this._box.remove();
    }
  }

  /* Returns the index of the last time that is not after `time_s`; 0 before the first. */
  function nearestBefore(times_s, time_s) {
    let [low, high] = [0, times_s.length - 1];
    while (low < high) {
      const middle = (low + high + 1) >> 1;
      if (times_s[middle] <= time_s + 1e-9) low = middle;
      else high = middle - 1;
    }
    return low;
  }

  function secondsText(time_s) {
    if (Math.abs(time_s) < 60) return `${Number(time_s.toFixed(3))} s`.replace("-", "−");
    return Covey.clock(time_s, Number.isInteger(time_s) ? 0 : 1);
  }

  Object.assign(Covey, { ChartGroup, nearestBefore });
})();
