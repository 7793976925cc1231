//! Words and bytes that come when they come: accounts of steps, states, the exact messages of wires.

use crate::chunks::{Clocks, Problem, TimedValues, columns, text};
use crate::read::BYTES;
use rerun::log::Chunk;
use rerun::{ComponentDescriptor, EntityPath, Loggable as _, SerializedComponentBatch};
use supertwin_core::Tick;

/// What came at one path since the last batch.
#[derive(Default)]
pub(crate) struct TextAndByteRows {
    texts: TimedValues<String>,
    blobs: TimedValues<Vec<u8>>,
}

impl TextAndByteRows {
    pub(crate) fn add_text(&mut self, tick: Tick, clocks: Clocks, words: String) {
        self.texts.add(tick, clocks, [words]);
    }

    pub(crate) fn add_bytes(&mut self, tick: Tick, clocks: Clocks, bytes: Vec<u8>) {
        self.blobs.add(tick, clocks, [bytes]);
    }

    /// What came, as chunks.
    pub(crate) fn chunks(&mut self, path: &str) -> Result<Vec<Chunk>, Problem> {
        let mut chunks = Vec::new();
        if let Some((times, words)) = self.texts.take() {
            let documents = rerun::TextDocument::update_fields().with_many_text(words);
            chunks.push(columns(EntityPath::from(path), times, documents.columns_of_unit_batches().map_err(text)?)?);
        }
        if let Some((times, blobs)) = self.blobs.take() {
            let rows = blobs.len();
            let blobs = blobs.into_iter().map(rerun::components::Blob::from);
            let array = rerun::components::Blob::to_arrow(blobs.map(std::borrow::Cow::Owned)).map_err(text)?;
            let column = SerializedComponentBatch::new(array, ComponentDescriptor::partial(BYTES))
                .partitioned(std::iter::repeat_n(1, rows))
                .map_err(text)?;
            chunks.push(columns(EntityPath::from(path), times, [column])?);
        }
        Ok(chunks)
    }
}
