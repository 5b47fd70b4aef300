// The plant card: the server judges typed values, its answers stand beside the fields, and a button states them.
//
// Rule: impossible values are not sent.  Unusual ones are sent by a button of their own, which shows only then.

import { act, page, server } from "./server.js";
import { textOf } from "./texts.js";

const formOf = (event) => event.target.closest?.("form[data-plant]");

document.addEventListener("change", (event) => {
  const form = formOf(event);
  if (form) judge(form);
});

document.addEventListener("submit", async (event) => {
  const form = formOf(event);
  if (!form) return;
  event.preventDefault();
  const confirmed = event.submitter?.value === "confirmed", judged = await judge(form);
  if (!judged || judged.answers.some((answer) => answer.error || !confirmed)) return;
  const command = { set_plant: { ...judged.command.set_plant, confirmed } };
  await act(textOf("plant.act"), `/api/${page.board}/command`, command);
});

// Show what the server says of the values, and return it; null where it does not answer.
async function judge(form) {
  const typed = new URLSearchParams(new FormData(form));
  try {
    const judged = await server.ask(`/api/${page.board}/plant?${typed}`, null, { method: "GET" });
    show(form, judged.answers);
    return judged;
  } catch (error) {
    show(form, [{ field: "name", text: textOf("plant.no_answer", { error: error.message }), error: true }]);
    return null;
  }
}

function show(form, answers) {
  for (const place of form.querySelectorAll("[data-answer]")) {
    const answer = answers.find(({ field }) => field === place.dataset.answer);
    place.textContent = answer?.text ?? "";
    place.dataset.error = answer?.error ? "yes" : "";
  }
  const asked = answers.length > 0 && !answers.some(({ error }) => error);
  form.querySelector("[data-unusual]").hidden = !asked;
  form.querySelector("[data-plausible]").hidden = asked;
}
