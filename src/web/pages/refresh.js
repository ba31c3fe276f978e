// Keeps the page fresh: every few seconds fetches it again and replaces what is inside <main>. Says since when nobody
// answers, so that an old page is not taken for a healthy machine.
"use strict";
const EVERY_MS = 5000;
const PATIENCE_MS = 10000;
let answered = new Date();

function say(text) {
  const note = document.getElementById("silence");
  note.hidden = text === "";
  if (note.textContent !== text) note.textContent = text;
}

// Keeps the place of the page, of its tables and of the keyboard.
function replace(main, fresh) {
  const place = [scrollX, scrollY];
  const wide = [...main.querySelectorAll(".scroll")].map((box) => box.scrollLeft);
  const focused = [...main.querySelectorAll("a, [tabindex]")].indexOf(document.activeElement);
  main.replaceChildren(...fresh.childNodes);
  main.querySelectorAll(".scroll").forEach((box, at) => { box.scrollLeft = wide[at] || 0; });
  if (focused >= 0) main.querySelectorAll("a, [tabindex]")[focused]?.focus({ preventScroll: true });
  scrollTo(...place);
}

async function refresh() {
  try {
    const answer = await fetch(location.href, { cache: "no-store", signal: AbortSignal.timeout(PATIENCE_MS) });
    const fresh = new DOMParser().parseFromString(await answer.text(), "text/html").querySelector("main");
    if (!answer.ok || !fresh) throw new Error(answer.statusText);
    if (getSelection().type === "Range") {
      say(`Not refreshed while text is selected: what you see is from ${answered.toLocaleTimeString()}.`);
    } else {
      replace(document.querySelector("main"), fresh);
      answered = new Date();
      say("");
    }
  } catch {
    say(`No answer since ${answered.toLocaleTimeString()}: what you see is from then.`);
  }
  setTimeout(refresh, EVERY_MS);
}

setTimeout(refresh, EVERY_MS);
