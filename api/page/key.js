// The dialog that asks for an API key.

import { useKey } from "./http.js";

let asking = null;

/** Whether a key was given. Callers that ask at once share one dialog. */
export function askKey(why) {
  asking ??= new Promise((resolve) => {
    const dialog = document.getElementById("ask");
    const input = document.getElementById("ask-key");
    const says = document.getElementById("ask-why");
    if (why) says.textContent = `${why[0].toUpperCase()}${why.slice(1)}. A key is kept until this tab is closed, and nowhere else.`;
    input.value = "";
    dialog.addEventListener("close", () => {
      asking = null;
      if (dialog.returnValue === "use") useKey(input.value.trim());
      if (dialog.returnValue === "forget") useKey("");
      resolve(dialog.returnValue === "use" && input.value.trim() !== "");
      dialog.returnValue = "";
    }, { once: true });
    dialog.showModal();
  });
  return asking;
}
