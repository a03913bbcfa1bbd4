/*
 * The time that a page shows: it plays, pauses, and goes where it is sent.
 *
 * Listeners are called once for each picture that is to be drawn: while it plays, and after each
 * change. While nothing changes nothing is drawn.
 */
"use strict";

globalThis.Covey ??= {};

(() => {
  const SPEEDS = [0.1, 0.25, 0.5, 1, 2, 4, 8, 16];

  class Player {
    constructor(begin_s, end_s) {
      this.begin_s = begin_s;
      this.end_s = end_s;
      this.time_s = begin_s;
      this.speed = 1;
      this.isPlaying = false;
      this._listeners = [];
      this._last_ms = null; // time of the picture before, while it plays
      this._isAsked = false; // a picture is under way
    }

    onPicture(listener) {
      this._listeners.push(listener);
    }

    /* Asks for a picture. */
    draw() {
      if (this._isAsked) return;
      this._isAsked = true;
      requestAnimationFrame((now_ms) => this._picture(now_ms));
    }

    _picture(now_ms) {
      this._isAsked = false;
      if (this.isPlaying) {
        // after a pause of the browser it goes on where it was
        const passed_ms = this._last_ms === null ? 0 : Math.min(200, now_ms - this._last_ms);
        this._last_ms = now_ms;
        this.time_s = this._limited(this.time_s + (passed_ms / 1000) * this.speed);
        if (this.time_s >= this.end_s) this.isPlaying = false;
      }
      if (!this.isPlaying) this._last_ms = null;

      for (const listener of this._listeners) listener();
      if (this.isPlaying) this.draw();
    }

    /* Plays or pauses; from the end it begins again. */
    toggle() {
      this.isPlaying = !this.isPlaying;
      if (this.isPlaying && this.time_s >= this.end_s) this.time_s = this.begin_s;
      this.draw();
    }

    seek(time_s) {
      this.time_s = this._limited(time_s);
      this.draw();
    }

    /* One picture on or back. */
    step(by_s) {
      this.isPlaying = false;
      this.seek(this.time_s + by_s);
    }

    /* Plays slower (-1) or faster (+1). */
    changeSpeed(by) {
      const index = SPEEDS.indexOf(this.speed) + by;
      this.setSpeed(SPEEDS[Math.min(SPEEDS.length - 1, Math.max(0, index))]);
    }

    setSpeed(speed) {
      this.speed = speed;
      this.draw();
    }

    _limited(time_s) {
      return Math.min(this.end_s, Math.max(this.begin_s, time_s));
    }
  }

  Object.assign(Covey, { Player, SPEEDS });
})();
