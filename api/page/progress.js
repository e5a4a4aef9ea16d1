// A job on the screen: its progress, and a button that cancels it.

import { button, el, problem, say } from "./dom.js";
import { ENDED, cancel, follow } from "./events.js";
import { Problem } from "./http.js";

/** Show a job until it ends; resolves with the job that is done, raises its problem. */
export async function watchJob(box, job, title, signal) {
  const bar = el("progress", { max: 1, value: job.progress.share, "aria-label": `progress of ${title}` });
  const words = el("p", { class: "quiet" }, job.state);
  const stop = button("Cancel", () => {
    stop.disabled = true;
    cancel(job.id).catch((error) => box.append(problem(error)));
  });
  box.replaceChildren(el("div", { class: "job" }, el("p", {}, title), bar, words, stop));
  let whole = -1;
  const ended = ENDED.includes(job.state) ? job : await follow(job.id, (now) => {
    bar.value = now.progress.share;
    words.textContent = `${now.state}: ${now.progress.what} (${Math.round(100 * now.progress.share)} %)`;
    // Who listens is told at every quarter, not at every event.
    if (Math.floor(4 * now.progress.share) > whole) say(`${title}: ${Math.round(100 * now.progress.share)} %`);
    whole = Math.max(whole, Math.floor(4 * now.progress.share));
  }, signal);
  box.replaceChildren();
  if (ended.state === "cancelled") throw new Problem({ title: "Cancelled", detail: `${title} was cancelled`, remedy: "start it again when you like" });
  if (ended.state === "failed") throw new Problem(ended.problem || { title: "Failed", detail: `${title} failed` });
  say(`${title} is done`);
  return ended;
}
