// Dialog of named poses, which are applied to a pair or to a part of the face.

import { button, node } from "./elements.js";

/** Emits `save` (detail: name) , `remove` (detail: name) and `apply` (detail: name, part). */
export class PoseDialog extends EventTarget {
  /** @param {HTMLDialogElement} dialog @param {string[]} parts of the face that have shapes */
  constructor(dialog, parts) {
    super();
    this.dialog = dialog;
    [this.part, this.name] = ["select", "input"].map((kind) => dialog.querySelector(kind));
    [this.list, this.save] = ["ul", ".save"].map((kind) => dialog.querySelector(kind));
    this.part.append(...parts.map((part) => new Option(part || "other", part)));
    this.name.addEventListener("input", () => this.#label());
    dialog.querySelector("form").addEventListener("submit", (event) => {
      const name = this.name.value.trim();
      if (event.submitter !== this.save || !name) return; // closed
      event.preventDefault();
      this.#tell("save", { name });
      this.name.value = "";
    });
  }

  get isOpen() {
    return this.dialog.open;
  }

  open() {
    this.dialog.showModal();
    this.name.focus();
  }

  close() {
    this.dialog.close();
  }

  /** @param {{[name: string]: {[shape: string]: number}}} poses */
  show(poses) {
    this.poses = poses;
    this.list.replaceChildren(...Object.keys(poses).map((name) => this.#item(name)));
    this.dialog.querySelector(".none").hidden = Boolean(this.list.children.length);
    this.#label();
  }

  #item(name) {
    const apply = button(name, "Apply this pose to the pair", () => {
      this.dialog.close();
      this.#tell("apply", { name, part: this.part.value });
    });
    const remove = button("Remove", "Remove this pose", () => this.#tell("remove", { name }));
    remove.setAttribute("aria-label", `Remove ${name}`);
    return node("li", {}, apply, remove);
  }

  #label() {
    const name = this.name.value.trim();
    this.save.disabled = !name;
    this.save.textContent = Object.hasOwn(this.poses ?? {}, name) ? "Replace" : "Save";
  }

  #tell(kind, detail) {
    this.dispatchEvent(new CustomEvent(kind, { detail }));
  }
}
