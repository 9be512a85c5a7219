/** Plays the rides that were recorded on a map. */
import { useEffect, useRef, useState } from "preact/hooks";
import type { Ride } from "../data";
import { rideShapes, type Shape } from "../drawing";
import { Choice } from "./Controls";

const RATE = 30;

/** The ride that is shown, and the step up to which it is drawn. */
export interface Playing {
  readonly ride: number;
  readonly step: number;
}

export const ridingShapes = (rides: readonly Ride[], { ride, step }: Playing): readonly Shape[] | undefined =>
  rides.length ? rideShapes(rides[Math.min(ride, rides.length - 1)], step) : undefined;

interface Props {
  readonly rides: readonly Ride[];
  readonly playing: Playing;
  readonly onPlay: (playing: Playing) => void;
}

export function Rides({ rides, playing, onPlay }: Props) {
  const [runs, setRuns] = useState(false);
  const chosen = Math.min(playing.ride, rides.length - 1);
  const ride = rides[chosen];
  const last = ride.x.length - 1;
  const now = useRef(playing);
  now.current = playing;
  useEffect(() => {
    if (!runs) return;
    let before = performance.now();
    let frame = requestAnimationFrame(function next(time) {
      const steps = Math.floor(((time - before) * RATE) / 1000);
      if (steps > 0) {
        before += (steps * 1000) / RATE;
        onPlay({ ride: chosen, step: Math.min(now.current.step + steps, last) });
      }
      if (now.current.step >= last) setRuns(false);
      else frame = requestAnimationFrame(next);
    });
    return () => cancelAnimationFrame(frame);
  }, [runs, chosen, last, onPlay]);
  const start = () => {
    if (!runs && playing.step >= last) onPlay({ ride: chosen, step: 0 });
    setRuns(!runs);
  };
  return (
    <div class="ride" role="group" aria-label="Recorded rides">
      <button type="button" class="switch" aria-pressed={runs} onClick={start}>
        {runs ? "Pause" : "Play the ride"}
      </button>
      <input
        type="range"
        min="0"
        max={last}
        value={Math.min(playing.step, last)}
        aria-label="Time of the ride"
        onInput={(event) => onPlay({ ride: chosen, step: Number(event.currentTarget.value) })}
      />
      <span>{(Math.min(playing.step, last) / RATE).toFixed(1)} s</span>
      {rides.length > 1 && (
        <Choice
          label="Ride"
          value={`${chosen}`}
          options={rides.map(
            (one, number) => [`${number}`, `${number + 1}${one.success ? "" : ", goal not reached"}`] as const,
          )}
          onChange={(number) => onPlay({ ride: Number(number), step: 0 })}
        />
      )}
    </div>
  );
}
