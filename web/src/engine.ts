// The skin in the page: a worker that runs the twin and its pipeline as a WebAssembly module (crates/dermis-wasm) and
// passes on its messages, which are the same as a server's. The page posts text for the skin, or whether it is
// hidden, in which case the skin pauses. It gets messages, or an object with the reason why there are no more.

interface Exports {
  memory: WebAssembly.Memory;
  dermis_start(frames_per_s: number): number;
  dermis_step(): void;
  dermis_rest(): void;
  dermis_input(bytes: number): number;
  dermis_hear(): void;
  dermis_next(): number;
  dermis_output(): number;
  dermis_output_bytes(): number;
}

/** Messages posted by the page. */
export type ToEngine = { text: string } | { isHidden: boolean };
/** Sent to the page in addition to messages. */
export interface EngineEnd {
  reason: string;
}

const FRAMES_PER_S = 30;
const REST_MS = 1000;
/** Kinds of messages returned by `dermis_next`. */
const [NOTHING, TEXT] = [0, 1];

const scope = self as unknown as { postMessage(message: string | ArrayBuffer | EngineEnd, transfer?: Transferable[]): void; onmessage: ((event: MessageEvent<ToEngine>) => void) | null };

async function load(): Promise<Exports> {
  const answer = await fetch("dermis_wasm.wasm");
  if (!answer.ok) throw new Error(`dermis_wasm.wasm: ${answer.status} ${answer.statusText}`);
  const { instance } = await WebAssembly.instantiate(await answer.arrayBuffer(), { env: { dermis_now_ms: () => performance.now() } });
  return instance.exports as unknown as Exports;
}

class Engine {
  private readonly decoder = new TextDecoder();
  private readonly encoder = new TextEncoder();
  private isHidden = false;
  private due = performance.now();

  constructor(private readonly skin: Exports) {}

  /** Builds the skin and runs it until it fails. */
  start(): void {
    this.guarded(() => {
      if (!this.skin.dermis_start(FRAMES_PER_S)) throw new Error(this.text());
      scope.onmessage = ({ data }) => this.guarded(() => this.hear(data));
      this.pass();
      this.due = performance.now();
      this.next();
    });
  }

  private hear(said: ToEngine): void {
    if ("isHidden" in said) {
      this.isHidden = said.isHidden;
      return;
    }
    const bytes = this.encoder.encode(said.text);
    const place = this.skin.dermis_input(bytes.length);
    new Uint8Array(this.skin.memory.buffer, place, bytes.length).set(bytes);
    this.skin.dermis_hear();
  }

  private next(): void {
    const period_ms = this.isHidden ? REST_MS : 1000 / FRAMES_PER_S;
    const now = performance.now();
    // Don't catch up on missed frames: the skin's clock follows the page's.
    this.due = Math.max(this.due + period_ms, now);
    setTimeout(() => this.guarded(() => this.run()), this.due - now);
  }

  private run(): void {
    if (this.isHidden) this.skin.dermis_rest();
    else this.skin.dermis_step();
    this.pass();
    this.next();
  }

  /** Passes on all waiting messages. */
  private pass(): void {
    for (;;) {
      const kind = this.skin.dermis_next();
      if (kind === NOTHING) return;
      if (kind === TEXT) {
        scope.postMessage(this.text());
      } else {
        const bytes = this.bytes().slice().buffer;
        scope.postMessage(bytes, [bytes]);
      }
    }
  }

  private bytes(): Uint8Array<ArrayBuffer> {
    return new Uint8Array(this.skin.memory.buffer as ArrayBuffer, this.skin.dermis_output(), this.skin.dermis_output_bytes());
  }

  private text(): string {
    return this.decoder.decode(this.bytes());
  }

  /** A module that has trapped leaves the reason in its output and runs no further. */
  private guarded(action: () => void): void {
    try {
      action();
    } catch (error) {
      const reason = error instanceof WebAssembly.RuntimeError ? this.text() || String(error) : String(error);
      scope.onmessage = null;
      scope.postMessage({ reason });
    }
  }
}

load().then(
  (skin) => new Engine(skin).start(),
  (error: unknown) => scope.postMessage({ reason: `the skin could not be loaded: ${error instanceof Error ? error.message : error}` }),
);
