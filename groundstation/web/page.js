"use strict";
document.getElementById("again").addEventListener("click", () => window.location.reload());
// The console is there: keys go to it without a click.
new MutationObserver((_, observer) => {
  const keys = document.querySelector("#terminal textarea");
  if (keys !== null && document.body.classList.contains("-first-byte")) {
    keys.focus();
    observer.disconnect();
  }
}).observe(document.body, { attributes: true, attributeFilter: ["class"] });
