// Keeps the page fresh: every few seconds fetches it again and replaces the banner and what is inside <main>. Says since
// when nobody answers, so that an old page is not taken for a healthy machine.
"use strict";
const EVERY_MS = 5000;
const PATIENCE_MS = 10000;
let answered = new Date();

function say(text) {
  const note = document.getElementById("silence");
  note.hidden = text === "";
  if (note.textContent !== text) note.textContent = text;
}

// Only what has changed is put there: a reader for the blind says it again each time.
function warn(fresh) {
  const banner = document.getElementById("trouble");
  if (banner.innerHTML === fresh.innerHTML) return;
  banner.hidden = fresh.hidden;
  banner.replaceChildren(...fresh.childNodes);
}

function since() {
  return `since ${answered.toISOString().slice(0, 19).replace("T", " ")} UTC: what you see is from then`;
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
    const page = new DOMParser().parseFromString(await answer.text(), "text/html");
    const fresh = page.querySelector("main");
    warn(page.getElementById("trouble"));
    if (!answer.ok) {
      say(`Not refreshed ${since()}. ${fresh.querySelector("p").textContent}`);
    } else if (getSelection().type === "Range") {
      say(`Not refreshed while text is selected, ${since()}.`);
    } else {
      replace(document.querySelector("main"), fresh);
      answered = new Date();
      say("");
    }
  } catch {
    say(`No answer ${since()}.`);
  }
  setTimeout(refresh, EVERY_MS);
}

setTimeout(refresh, EVERY_MS);
