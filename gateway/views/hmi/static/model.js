// The page of a model: what is written there is fetched again when a job has ended or the twin runs on another model.

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

// A part that says the same stays, so that no button is replaced under a finger and no form loses what was typed.
const said = (part) => part.innerHTML.replace(/ (data-refused="\w*"|hidden="")/g, ""); // of what hmi.js changes: no news
async function renew() {
  const answer = await fetch(location.href).catch(() => null);
  if (!answer?.ok || answer.redirected) return;
  const made = new DOMParser().parseFromString(await answer.text(), "text/html");
  for (const fresh of made.querySelectorAll("[data-part]")) {
    const present = document.querySelector(`[data-part="${fresh.dataset.part}"]`);
    if (present && said(present) !== said(fresh)) present.replaceWith(document.adoptNode(fresh));
  }
}
