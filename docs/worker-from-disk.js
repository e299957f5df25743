/* The search of the site runs in a Worker, which browsers refuse to pages that are opened from disk.
   There this class takes its place: it runs the script in a hidden frame. */
(() => {
"use strict";
if (location.protocol !== "file:") return;

window.Worker = class {
  onmessage = null;
  onerror = null;
  onmessageerror = null;
  #frame = document.createElement("iframe");
  #isReady = false;
  #waiting = [];

  constructor(address) {
    this.#frame.hidden = true;
    document.body.append(this.#frame);
    const inside = this.#frame.contentWindow;
    inside.postMessage = (data) => setTimeout(() => this.onmessage?.(new MessageEvent("message", { data })));
    const script = inside.document.createElement("script");
    script.addEventListener("load", () => {
      this.#isReady = true;
      this.#waiting.splice(0).forEach((data) => this.postMessage(data));
    });
    script.addEventListener("error", (event) => this.onerror?.(event));
    script.src = new URL(address, location.href).href;
    inside.document.body.append(script);
  }

  postMessage(data) {
    if (!this.#isReady) {
      this.#waiting.push(data);
      return;
    }
    const inside = this.#frame.contentWindow;
    inside?.dispatchEvent(new inside.MessageEvent("message", { data }));
  }

  terminate() {
    this.#frame.remove();
  }
};
})();
