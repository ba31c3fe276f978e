// Refreshes the page every few seconds. If the daemon has a new page, replaces the banner and the content of <main>. Without
// an answer, shows the time of the last answer, so that an old page is recognised.
"use strict";
const SOON_MS = 5000; // wait after a change
const LATER_MS = 10000; // wait while nothing changes: 4 kB a minute
const TIMEOUT_MS = 10000; // time limit of a request
let answered = new Date();
let tag = "";

function say(text) {
  const note = document.getElementById("silence");
  note.hidden = text === "";
  if (note.textContent !== text) note.textContent = text;
}

// Replaces the banner only if it differs, as a screen reader reads the banner again after each change.
function warn(fresh) {
  const banner = document.getElementById("trouble");
  if (banner.innerHTML === fresh.innerHTML) return;
  banner.hidden = fresh.hidden;
  banner.replaceChildren(...fresh.childNodes);
}

function since() {
  return `since ${answered.toISOString().slice(0, 19).replace("T", " ")} UTC: this page is from then`;
}

// Adds the local time to each time on the page, as a tooltip.
function localTimes() {
  for (const time of document.querySelectorAll("time")) {
    const at = new Date(time.textContent.replace(" UTC", "Z").replace(" ", "T"));
    if (!isNaN(at)) time.title = at.toLocaleString(undefined, { timeZoneName: "short" });
  }
}

// Replaces <main>, and keeps the scroll positions and the focus.
function replace(main, fresh) {
  const place = [scrollX, scrollY];
  const wide = [...main.querySelectorAll(".scroll")].map((box) => box.scrollLeft);
  const focused = [...main.querySelectorAll("a, button, [tabindex]")].indexOf(document.activeElement);
  main.replaceChildren(...fresh.childNodes);
  main.querySelectorAll(".scroll").forEach((box, at) => { box.scrollLeft = wide[at] || 0; });
  document.dispatchEvent(new Event("replaced"));
  if (focused >= 0) main.querySelectorAll("a, button, [tabindex]")[focused]?.focus({ preventScroll: true });
  scrollTo(...place);
  localTimes();
}

// Whether the reader selects text, fills in a form or drags a chart: the page is then not replaced.
function isBusy() {
  if (getSelection().type === "Range" || document.querySelector(".u-over:active")) return true;
  const fields = document.querySelectorAll("main input, main select");
  // A choice counts too: a command that falls back to the first one of the list would be another command.
  const first = ({ options }) => ([...options].find((option) => option.defaultSelected) ?? options[0])?.value;
  return [...fields].some((field) => field === document.activeElement || field.value !== (field.defaultValue ?? first(field)));
}

async function refresh() {
  let wait = LATER_MS;
  try {
    const headers = tag ? { "If-None-Match": tag } : {};
    const answer = await fetch(location.href, { cache: "no-store", headers, signal: AbortSignal.timeout(TIMEOUT_MS) });
    if (answer.status === 304) {
      answered = new Date();
      say("");
    } else {
      const page = new DOMParser().parseFromString(await answer.text(), "text/html");
      const fresh = page.querySelector("main");
      warn(page.getElementById("trouble"));
      if (!answer.ok) {
        say(`Not refreshed ${since()}. ${fresh.querySelector("p").textContent}`);
      } else if (isBusy()) {
        say(`Not refreshed while you write or select text, ${since()}.`);
      } else {
        replace(document.querySelector("main"), fresh);
        if (tag && tag !== answer.headers.get("ETag")) wait = SOON_MS;
        tag = answer.headers.get("ETag") || "";
        answered = new Date();
        say("");
      }
    }
  } catch {
    say(`No answer ${since()}.`);
  }
  setTimeout(refresh, wait);
}

localTimes();
setTimeout(refresh, SOON_MS);
