/** The bar at the top: the choice of a run, the tabs of the views, the colours. */
import { useShared } from "../context";
import { openRun, VIEWS, VIEW_NAMES, type ViewName } from "../state";
import { Choice } from "./Controls";

export function Header({ onTheme }: { readonly onTheme: () => void }) {
  const { data, run, view, dark, show } = useShared();
  const colours = dark ? "Light colours" : "Dark colours";
  return (
    <header class="top">
      <h1>
        <Logo />
        Elite Lanes
      </h1>
      {data.runs.length > 1 ? (
        <Choice
          label="Run"
          value={`${view.run}`}
          options={data.runs.map((one, index) => [`${index}`, one.name] as const)}
          onChange={(index) => show(openRun(view, Number(index)))}
        />
      ) : (
        <span class="name">{data.title || run.name}</span>
      )}
      <Tabs />
      <button type="button" class="theme" aria-label={colours} title={colours} onClick={onTheme}>
        {dark ? "☀" : "☾"}
      </button>
    </header>
  );
}

function Logo() {
  return (
    <svg viewBox="0 0 24 24" aria-hidden="true">
      <rect width="24" height="24" rx="6" />
      <path class="road" d="M12 24V14a6 6 0 0 1 6-6h6M12 14V0M0 16h12" />
      <path class="lane" d="M12 24V14a6 6 0 0 1 6-6h6" />
    </svg>
  );
}

/** The tabs: Tab leads to the selected one, arrow keys to the others. */
function Tabs() {
  const { data, run, view, show } = useShared();
  const hasRunView = data.runs.length > 1 || run.history !== null || Object.keys(run.record).length > 0;
  const tabs = VIEWS.filter((name) => name !== "run" || hasRunView);
  const keys = (event: KeyboardEvent) => {
    const now = tabs.indexOf(view.view);
    const next = { ArrowLeft: now - 1 + tabs.length, ArrowRight: now + 1, Home: 0, End: tabs.length - 1 }[event.key];
    if (next === undefined) return;
    event.preventDefault();
    const index = next % tabs.length;
    show({ view: tabs[index] });
    ((event.currentTarget as HTMLElement).children[index] as HTMLElement).focus();
  };
  const tab = (name: ViewName) => (
    <button
      key={name}
      type="button"
      role="tab"
      aria-selected={view.view === name}
      tabIndex={view.view === name ? 0 : -1}
      onClick={() => show({ view: name })}
    >
      {VIEW_NAMES[name]}
      {name === "compare" && view.pins.length > 0 && <b>{view.pins.length}</b>}
    </button>
  );
  return (
    <div class="tabs" role="tablist" aria-label="Views" onKeyDown={keys}>
      {tabs.map(tab)}
    </div>
  );
}
