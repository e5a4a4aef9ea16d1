// Jobs: started, followed by their events, cancelled.

import { get, post, request } from "./http.js";

export const ENDED = ["done", "failed", "cancelled"];

/** Follow a job to its end; `told` gets the job at each event. Lost connections are taken up again. */
export async function follow(id, told, signal) {
  let last = 0;
  for (let failures = 0; ; ) {
    try {
      const answer = await request(`/v1/jobs/${id}/events`, { signal, headers: last ? { "Last-Event-ID": String(last) } : {} });
      for await (const event of events(answer.body)) {
        failures = 0;
        last = event.id || last;
        const job = JSON.parse(event.data);
        told(job);
        if (ENDED.includes(job.state)) return job;
      }
      const job = await get(`/v1/jobs/${id}`, { signal });
      if (ENDED.includes(job.state)) return job;
    } catch (error) {
      // What the service refuses it will refuse again; "no answer" and its own failures may pass.
      if (error.name === "AbortError" || error.document?.status < 500 || ++failures > 5) throw error;
    }
    await new Promise((go) => setTimeout(go, 500 * 2 ** failures));
  }
}

/** Start a job. */
export const start = (kind, json, panel) => post(`/v1/${kind}`, json, { panel });

/** Ask a job to end. */
export const cancel = (id) => post(`/v1/jobs/${id}/cancel`);

// A browser's EventSource can't send a key, so the stream is read here (WHATWG HTML, 9.2).
async function* events(body) {
  const reader = body.pipeThrough(new TextDecoderStream()).getReader();
  let waiting = "";
  for (;;) {
    const { done, value } = await reader.read();
    if (done) return;
    // A line's end may be cut in two.
    waiting = (waiting + value).replaceAll("\r\n", "\n");
    const blocks = waiting.split("\n\n");
    waiting = blocks.pop();
    for (const block of blocks) {
      const event = { id: 0, data: "" };
      for (const line of block.split("\n")) {
        const [, name, text] = /^(\w*): ?(.*)$/.exec(line) || [];
        if (name === "data") event.data += (event.data && "\n") + text;
        if (name === "id") event.id = Number(text);
      }
      if (event.data) yield event;
    }
  }
}
