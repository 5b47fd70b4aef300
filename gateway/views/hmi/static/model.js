// The page of a model: its content is fetched again when a job has ended or the twin runs on another model.

import "./plant.js";

let running = null; // kinds of the jobs that ran when last heard

document.addEventListener("board51-jobs", (event) => {
  const now = new Set(Object.entries(event.detail).filter(([, job]) => job.running).map(([kind]) => kind));
  const ended = running && [...running].some((kind) => !now.has(kind));
  running = now;
  if (ended) renew();
});

document.addEventListener("board51-changed", () => renew());

let model = null; // of the twin, when last heard
let gains = null; // of the board, when last heard

document.addEventListener("board51-rest", (event) => {
  const now = event.detail.model?.sha256 ?? "";
  if (now !== (model ?? document.querySelector("[data-model]")?.dataset.model ?? "")) renew();
  model = now;
  const { law, gains: held } = event.detail.limits ?? {}, loaded = JSON.stringify([law, held]);
  if (gains !== null && loaded !== gains) renew();
  gains = loaded;
  if (document.querySelector("[data-stated]").dataset.stated !== String(event.detail.plant_ms)) renew();
});

// A button that is replaced between press and release is never clicked: parts wait until it is let go, which a page
// does not hear of where the pointer has left it.
const HELD_MS = 10_000;
let letGo = Promise.resolve(), release = null;
document.addEventListener("pointerdown", () => {
  letGo = new Promise((resolve) => {
    release = resolve;
    setTimeout(resolve, HELD_MS);
  });
}, true);
document.addEventListener("pointerup", () => setTimeout(() => release?.()), true); // the click comes first

// One after another: an answer that was asked for earlier never replaces a later one.
let renewal = Promise.resolve();
const renew = () => (renewal = renewal.then(fetched).catch(() => null));

// A part that says the same stays, so that no form loses what was typed.
const said = (part) => part.innerHTML.replace(/ (data-refused="\w*"|hidden="")/g, ""); // of what hmi.js changes: no news
async function fetched() {
  const answer = await fetch(location.href);
  if (!answer.ok || answer.redirected) return;
  const made = new DOMParser().parseFromString(await answer.text(), "text/html");
  await letGo;
  for (const fresh of made.querySelectorAll("[data-part]")) {
    const present = document.querySelector(`[data-part="${fresh.dataset.part}"]`);
    if (present && said(present) !== said(fresh)) present.replaceWith(document.adoptNode(fresh));
  }
}
