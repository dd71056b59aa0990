"use strict";
// What is closed on the screen is open on paper, long tables apart.
addEventListener("beforeprint", () => {
  for (const part of document.querySelectorAll("details:not([open], .long)")) {
    part.open = true;
    part.dataset.closed = "";
  }
});
addEventListener("afterprint", () => {
  for (const part of document.querySelectorAll("details[data-closed]")) {
    part.open = false;
    delete part.dataset.closed;
  }
});
// A link to a row opens what the row is in.
const open_target = () => {
  const target = location.hash && document.getElementById(location.hash.slice(1));
  for (let part = target; part; part = part.parentElement) if (part.tagName === "DETAILS") part.open = true;
  if (target) target.scrollIntoView();
};
addEventListener("hashchange", open_target);
open_target();
