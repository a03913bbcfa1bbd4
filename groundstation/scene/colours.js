/*
 * Colours of vehicles and of the page.
 *
 * A vehicle has the same colour here as in the figures of `covey plot`; they differ also for people
 * with a common colour blindness. On a dark page they are lighter. No meaning stands on a colour
 * alone: vehicles have their names beside them, verdicts a sign and a word.
 */
"use strict";

globalThis.Covey ??= {};

(() => {
  const ON_LIGHT = [
    "#0072B2", "#D55E00", "#009E73", "#CC79A7", "#B97F00", "#3D9BD4", "#7A5230", "#111111",
  ];
  const ON_DARK = [
    "#4FB0EE", "#F58B4C", "#2DCB9D", "#E7A3CB", "#F2BD55", "#97D5FA", "#CFA37A", "#E8ECF0",
  ];

  const darkness = globalThis.matchMedia?.("(prefers-color-scheme: dark)");

  function isDark() {
    return Boolean(darkness?.matches);
  }

  /* Calls a function whenever the computer changes between light and dark. */
  function onThemeChange(listener) {
    darkness?.addEventListener("change", listener);
  }

  /* Returns the colour of the vehicle with this index in the fleet, as text. */
  function vehicleColour(index) {
    const colours = isDark() ? ON_DARK : ON_LIGHT;
    return colours[index % colours.length];
  }

  /* Returns a colour of page.css, as `colour("line")`. */
  function colour(name) {
    return getComputedStyle(document.documentElement).getPropertyValue(`--${name}`).trim();
  }

  /* Returns red, green and blue, 0 to 1 each, of "#rrggbb". */
  function rgb(text) {
    const value = Number.parseInt(text.slice(1), 16);
    return [(value >> 16) / 255, ((value >> 8) & 255) / 255, (value & 255) / 255];
  }

  Object.assign(Covey, { isDark, onThemeChange, vehicleColour, colour, rgb });
})();
