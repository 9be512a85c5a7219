import { useCallback, useEffect, useState } from "preact/hooks";

const LONGEST = 300;

interface Message {
  readonly text: string;
  readonly shown: boolean;
}

/** Returns the message of the moment and a function that says one. An unseen message is for screen readers. */
export function useMessage(): [message: Message, say: (text: string, unseen?: boolean) => void] {
  const [message, setMessage] = useState<Message>({ text: "", shown: false });
  const say = useCallback((text: string, unseen = false) => {
    setMessage({ text: text.length > LONGEST ? `${text.slice(0, LONGEST - 1)}…` : text, shown: !unseen });
  }, []);
  useEffect(() => {
    if (!message.text) return;
    const timer = setTimeout(() => setMessage({ text: "", shown: false }), 4000 + 40 * message.text.length);
    return () => clearTimeout(timer);
  }, [message]);
  return [message, say];
}
