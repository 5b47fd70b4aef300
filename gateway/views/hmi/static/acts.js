// The controls: buttons and forms into requests.  Rule: a press is answered, or shown as not sent.

import { cell as element, put } from "./dom.js";
import { act, page, server } from "./server.js";

const SURE_MS = 5000;
const COUNT_M = 5e-7; // the board's reference is in counts of its converter: smaller differences are rounding
const metres = (mm) => mm / 1e3; // not mm * 1e-3: 5.2 * 1e-3 is above 0.0052
const command = (name, body) => act(name, `/api/${page.board}/command`, body);
const job = (name, body) => act(name, `/api/${page.board || "*"}/job`, body);

// What a form sends: {name: what it is called, path or body}.  Numbers leave in SI units.
const FORMS = {
  reference: (f) => ({ name: `reference ${f.mm} mm`, send: (name) => command(name, { set_reference: { x_ref_m: metres(f.mm) } }) }),
  excitation: (f) => {
    const on_reference = f.on === "reference", si = on_reference ? metres : Number, unit = on_reference ? "mm" : "V";
    const excite = { shape: f.shape, on_reference, amplitude: si(f.amplitude), offset: si(f.offset), period_s: Number(f.period),
                     period_end_s: f.shape === "SHAPE_CHIRP" ? Number(f.period_end) : 0, seed: 1, duration_s: Number(f.duration) };
    const length = excite.duration_s ? `for ${f.duration} s` : "until it is ended";
    const word = f.shape.replace("SHAPE_", "").toLowerCase();
    return { name: `excitation ${word} of ${f.amplitude} ${unit} around ${f.offset} ${unit}, ${length}`, send: (name) => command(name, { excite }) };
  },
  recording: (f) => ({ name: "recording", send: (name) => job(name, { kind: "record", act: "start", title: f.title }) }),
  mark: (f) => ({ name: `mark ${f.text}`, send: (name) => command(name, { mark: { text: f.text } }) }),
};

async function submit(form) {
  const { name, send } = FORMS[form.dataset.form](Object.fromEntries(new FormData(form)));
  const answer = await send(name);
  // What was not taken must not stand there as if it were in force.
  form.dataset.refused = answer?.accepted ? "" : "yes";
  if (form.dataset.form !== "reference") return;
  form.dataset.unsent = "";
  if (!answer?.accepted) follow(latest, old, true);
}

const ACTS = {
  acknowledge: (b) => act(`acknowledge ${b.dataset.name}`, `/api/${page.board}/acknowledge`, { name: b.dataset.name }),
  "end-excitation": () => command("end of the excitation", { excite: { shape: "SHAPE_NONE", on_reference: latest?.mode !== "open loop" } }),
  "log-out": async () => {
    await fetch("/logout", { method: "POST", headers: { "x-board51-token": page.token } }).catch(() => null);
    location.href = "/login";
  },
  delete: deleteLog,
  remove: (b) => act(`remove ${b.dataset.board}`, `/api/${b.dataset.board}/remove`, {}),
  close: (b) => b.closest("dialog").close(),
  summary,
};

async function pressed(button) {
  button.setAttribute("aria-busy", "true");
  try {
    if (button.dataset.command) await command(button.textContent, JSON.parse(button.dataset.command));
    else if (button.dataset.job) {
      const answer = await job(button.textContent, JSON.parse(button.dataset.job));
      if (answer?.accepted && button.dataset.then) location.href = button.dataset.then;
    } else await ACTS[button.dataset.act]?.(button);
  } finally {
    button.removeAttribute("aria-busy");
  }
}

// The second click of a double click, and a press while the first one waits for its answer, are no presses of their own.
let before = null; // the button of the last click

document.addEventListener("click", (event) => {
  const button = event.target.closest?.("button");
  if (!button || button.dataset.act === "stop") return;
  const again = button === before && event.detail > 1;
  before = button;
  if (again || button.hasAttribute("aria-busy")) event.preventDefault();
  else if (button.matches("[data-command], [data-job], [data-act]")) pressed(button);
});
document.addEventListener("submit", (event) => {
  if (!event.target.dataset.form) return;
  event.preventDefault();
  submit(event.target);
});
document.addEventListener("input", (event) => {
  const form = event.target.closest?.("form[data-form]");
  if (!form) return;
  form.dataset.refused = "";
  if (form.dataset.form === "reference") {
    form.dataset.unsent = "yes";
    const other = event.target.name === "slide" ? form.mm : form.slide;
    other.value = event.target.value;
  }
  if (form.dataset.form === "excitation") units(form);
});
document.addEventListener("change", (event) => {
  if (event.target.dataset?.slider) submit(event.target.form); // when the handle is let go, not on its way
  if (event.target.dataset?.file) gains(event.target);
});

function units(form) {
  const unit = form.elements.on.value === "reference" ? "mm" : "V";
  form.querySelector("[data-label=amplitude]").textContent = `amplitude, ${unit}`;
  form.querySelector("[data-label=offset]").textContent = `around, ${unit}`;
  form.period_end.closest("label").hidden = form.elements.shape.value !== "SHAPE_CHIRP";
}
for (const form of document.querySelectorAll("[data-form=excitation]")) units(form);

// --- the reference in force -------------------------------------------------------------------------------------------

let latest = null, old = false, followed = NaN;

// Show the reference that samples say is in force, or said last where `gone`; what was typed and is not sent yet is left
// alone unless `force`.
export function follow(now, gone, force = false) {
  [latest, old] = [now, gone];
  const form = document.querySelector("[data-form=reference]"), x_ref = now?.x_ref_m;
  if (!form || x_ref === null || x_ref === undefined) return;
  const unsent = form.dataset.unsent === "yes", words = unsent ? " \u00b7 the field is not sent yet" : "";
  put("reference-now", `${gone ? "last known" : "in force"}: ${(x_ref * 1e3).toFixed(3)} mm${words}`);
  if (!force && (unsent || Math.abs(x_ref - followed) < COUNT_M)) return;
  followed = x_ref;
  form.mm.value = form.slide.value = (x_ref * 1e3).toFixed(3);
}

// What gateway and board both let through.
export function limits(rest) {
  const form = document.querySelector("[data-form=reference]"), l = rest.limits;
  if (!form || !l || !(l.x_max_mm > l.x_min_mm)) return;
  const [low, high] = [l.x_min_mm, l.x_max_mm];
  Object.assign(form.slide, { min: low, max: high });
  put("reference-range", `${low} .. ${high} mm, steps of ${Number((l.step_m * 1e3).toPrecision(2))} mm at most`);
}

// --- jobs, gains, summaries ---------------------------------------------------------------------------------------------

const IDLE_WORDS = { record: "The gateway always writes its log; a recording is a separate file." };
const KINDS = ["record", "campaign", "identify", "diagnose", "hand-over"];

export function showJobs(jobs) {
  for (const kind of KINDS) {
    const job = jobs[kind], running = Boolean(job?.running);
    for (const element of document.querySelectorAll(`[data-idle=${kind}]`)) element.hidden = running;
    for (const element of document.querySelectorAll(`[data-running=${kind}]`)) element.hidden = !running;
    const last = kind === "record" && job?.lines.length ? `: ${job.lines[job.lines.length - 1]}` : "";
    const said = job ? `${running ? "\u25cf" : "\u25cb"} ${job.title}, ${job.who}: ${job.standing}${last}` : IDLE_WORDS[kind] ?? "";
    put(`${kind}-said`, said);
    put(`${kind}-lines`, (job?.lines ?? []).join("\n"));
  }
  document.dispatchEvent(new CustomEvent("board51-jobs", { detail: jobs }));
}

// A file is read by the server and shown; it is sent by a press of its own.
async function gains(input) {
  const file = input.files[0], preview = document.querySelector(".preview");
  preview.replaceChildren();
  if (!file) return;
  const answer = await act(`read ${file.name}`, `/api/${page.board}/gains`, file);
  input.value = "";
  if (!answer) return;
  if (!answer.accepted) return preview.replaceChildren(element("div", `\u2715 ${file.name}: ${answer.text}`, "refused"));
  const table = element("table", "", "gains-table");
  for (const row of [{ name: "", now: "now", new: "new", unit: "" }, ...answer.rows]) {
    const line = element("tr", "");
    line.append(...["name", "now", "new", "unit"].map((name) => element("td", row[name])));
    table.append(line);
  }
  const send = element("button", "Send these gains to the board", "filled"), discard = element("button", "Discard", "plain");
  send.onclick = async () => (await command(`gains of ${file.name}`, answer.command))?.accepted && preview.replaceChildren();
  discard.onclick = () => preview.replaceChildren();
  const buttons = element("div", "", "row-of");
  buttons.append(send, discard);
  preview.replaceChildren(element("div", `${file.name}: ${answer.law}. Nothing is sent yet.`, "hint"), table, buttons);
}

// Asks by a second press, and forgets the first one after a while.
async function deleteLog(button) {
  if (button.dataset.sure !== "yes") {
    button.dataset.sure = "yes";
    button.textContent = "Delete for good?";
    setTimeout(() => {
      button.dataset.sure = "";
      button.textContent = "Delete";
    }, SURE_MS);
    return;
  }
  const answer = await act(`delete ${button.dataset.log}`, "/api/*/delete", { log: button.dataset.log });
  if (answer?.accepted) button.closest(".log").remove();
}

document.querySelector("[data-filter=log]")?.addEventListener("input", (event) => {
  const wanted = event.target.value.toLowerCase();
  for (const row of document.querySelectorAll(".log")) row.hidden = !row.textContent.toLowerCase().includes(wanted);
});

async function summary(button) {
  const dialog = document.querySelector("dialog.summary"), text = dialog.querySelector(".summary-text");
  dialog.querySelector(".file-name").textContent = button.dataset.log;
  text.textContent = "reading \u2026";
  dialog.show(); // not modal: STOP stays within reach
  try {
    const answer = await server.ask(`/api/summary/${button.dataset.log}`, null, { method: "GET", limit: 130 });
    text.textContent = answer.text;
  } catch (error) {
    text.textContent = `It could not be read: ${error.message}.`;
  }
}

