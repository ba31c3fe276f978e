// Keeps the page fresh: every few seconds fetches it again and replaces what is inside <main>. Says since when nobody
// answers, so that an old page is not taken for a healthy machine.
"use strict";
const EVERY_MS = 5000;
const PATIENCE_MS = 10000;
let answered = new Date();

function silence(text) {
  const note = document.getElementById("silence");
  note.hidden = text === "";
  if (note.textContent !== text) note.textContent = text;
}

async function refresh() {
  try {
    const answer = await fetch(location.href, { cache: "no-store", signal: AbortSignal.timeout(PATIENCE_MS) });
    const fresh = new DOMParser().parseFromString(await answer.text(), "text/html").querySelector("main");
    if (!answer.ok || !fresh) throw new Error(answer.statusText);
    const main = document.querySelector("main");
    // Neither the reader's selection nor the place of the keyboard is taken away.
    const busy = getSelection().type === "Range" || main.contains(document.activeElement);
    if (!busy) {
      const place = [scrollX, scrollY];
      const wide = [...main.querySelectorAll(".scroll")].map((box) => box.scrollLeft);
      main.replaceChildren(...fresh.childNodes);
      main.querySelectorAll(".scroll").forEach((box, at) => { box.scrollLeft = wide[at] || 0; });
      scrollTo(...place);
    }
    answered = new Date();
    silence("");
  } catch {
    silence(`No answer since ${answered.toLocaleTimeString()}: what you see is from then.`);
  }
  setTimeout(refresh, EVERY_MS);
}

setTimeout(refresh, EVERY_MS);
